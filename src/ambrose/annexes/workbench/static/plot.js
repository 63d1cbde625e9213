// Canvases in the look of the pages: circles of an orbit, curves over an axis, a waterfall.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export let ink = {};
function look() {
  for (const name of ["ink", "muted", "faint", "paper", "limit", "line", "line2", "line3", "line4",
    "good", "warm"]) ink[name] = colour(`--${name}`);
}
look();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", look);
export const series = () => [ink.line, ink.line2, ink.line3, ink.line4];

export function canvas(words, height) {
  const element = document.createElement("canvas");
  element.setAttribute("role", "img");
  element.setAttribute("aria-label", words);
  if (height) element.style.height = `${height}px`;
  else element.style.aspectRatio = "1";
  return element;
}

// the drawing context, cleared, in CSS pixels
export function begin(element) {
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const { clientWidth: width, clientHeight: height } = element;
  if (element.width !== Math.round(width * scale)) element.width = Math.round(width * scale);
  if (element.height !== Math.round(height * scale)) element.height = Math.round(height * scale);
  const g = element.getContext("2d");
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, width, height);
  g.font = "12px Helvetica, Arial, sans-serif";
  g.lineWidth = 1.5;
  return { g, width, height };
}

export function write(g, text, x, y, align = "center", fill = ink.muted) {
  g.fillStyle = fill;
  g.textAlign = align;
  g.fillText(text, x, y);
}

// the least and the largest of some values from a place on, a step apart
export function extent(values, from = 0, step = 1) {
  let [low, high] = [Infinity, -Infinity];
  for (let k = from; k < values.length; k += step) {
    if (values[k] < low) low = values[k];
    if (values[k] > high) high = values[k];
  }
  return [low, high];
}

export function path(g, count, x, y, stroke, dash = []) {
  g.setLineDash(dash);
  g.strokeStyle = stroke;
  g.beginPath();
  for (let i = 0; i < count; i += 1) g.lineTo(x(i), y(i));
  g.stroke();
  g.setLineDash([]);
}

export function circle(g, x, y, radius, stroke, dash = []) {
  const turn = (i) => (2 * Math.PI * i) / 72;
  path(g, 73, (i) => x + radius * Math.cos(turn(i)), (i) => y + radius * Math.sin(turn(i)), stroke, dash);
}

// 1, 2 or 5 times a power of ten, at least the value
export function rounded(value) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-12)));
  return power * ([1, 2, 5, 10].find((step) => step * power >= value * 0.999) || 10);
}

const SIGNS = { "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M" };
export function short(value, unit) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const plain = !size || /^(rpm|bar|×|%|°|g mm|N s)$/.test(unit);
  const power = plain ? 0 : Math.min(6, Math.max(-9, 3 * Math.floor(Math.log10(size) / 3 + 1e-9)));
  return `${Number((value / 10 ** power).toPrecision(3))} ${SIGNS[power]}${unit}`.trim();
}

// curves: [{x, y, stroke, dash}]; axes: {x: [low, high], y: [low, high], log: [x, y], names, marks}
export function curves(element, list, axes) {
  const { g, width, height } = begin(element);
  const [left, right, top, bottom] = [50, 8, 8, 34];
  const scale = (range, log, from, to) => {
    const f = log ? (v) => Math.log10(Math.max(v, 1e-30)) : (v) => v;
    const [low, high] = range.map(f);
    return (v) => from + ((f(v) - low) / (high - low || 1)) * (to - from);
  };
  const X = scale(axes.x, axes.log?.[0], left, width - right);
  const Y = scale(axes.y, axes.log?.[1], height - bottom, top);
  g.lineWidth = 1;
  ticks(axes.x, axes.log?.[0], (width - left) / 70).forEach((v) => {
    path(g, 2, () => X(v), (i) => [top, height - bottom][i], ink.faint);
    write(g, short(v, ""), X(v), height - bottom + 14);
  });
  ticks(axes.y, axes.log?.[1], (height - bottom) / 30).forEach((v) => {
    path(g, 2, (i) => [left, width - right][i], () => Y(v), ink.faint);
    write(g, short(v, ""), left - 5, Y(v) + 4, "right");
  });
  write(g, axes.names[0], (left + width) / 2, height - 4);
  write(g, axes.names[1], left + 5, top + 12, "left");
  g.save();
  g.beginPath();
  g.rect(left, top, width - left - right, height - top - bottom);
  g.clip();
  for (const value of axes.marks || []) path(g, 2, () => X(value), (i) => i * height, ink.limit, [2, 3]);
  g.lineWidth = 1.6;
  for (const c of list) path(g, c.x.length, (i) => X(c.x[i]), (i) => Y(c.y[i]), c.stroke, c.dash);
  g.restore();
}

function ticks([low, high], log, room) {
  if (log) {
    const decades = [];
    const from = Math.ceil(Math.log10(low) - 1e-9);
    const to = Math.floor(Math.log10(high) + 1e-9);
    for (let p = from; p <= to; p += Math.ceil((to - from + 1) / room)) decades.push(10 ** p);
    return decades.length > 1 ? decades : [low, high];
  }
  const step = rounded((high - low) / room);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
}
