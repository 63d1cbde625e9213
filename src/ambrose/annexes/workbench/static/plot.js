// Canvases in the look of the pages: circles of an orbit, curves over an axis, a waterfall.
import { make } from "/static/page.js";

export const ink = {};
function look() {
  const css = getComputedStyle(document.documentElement);
  for (const name of ["ink", "muted", "faint", "limit", "line", "line2", "warm"])
    ink[name] = css.getPropertyValue(`--${name}`).trim();
}
look();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", look);

export function canvas(words, height) {
  const element = make("canvas", { role: "img", ariaLabel: words });
  if (height) element.style.height = `${height}px`;
  else element.style.aspectRatio = "1";
  sized.observe(element);
  seen.observe(element);
  return element;
}

// sizes come without asking for a layout; what is out of sight is not drawn
const sized = new ResizeObserver((all) => all.forEach((e) => { e.target.room = e.contentRect; }));
const seen = new IntersectionObserver((all) => all.forEach((e) => { e.target.away = !e.isIntersecting; }));

// the drawing context, cleared, in CSS pixels
export function begin(element) {
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  element.room ??= { width: element.clientWidth, height: element.clientHeight };
  const { width, height } = element.room;
  if (element.width !== Math.round(width * scale)) element.width = Math.round(width * scale);
  if (element.height !== Math.round(height * scale)) element.height = Math.round(height * scale);
  const g = element.getContext("2d");
  g.setTransform(scale, 0, 0, scale, 0, 0);
  g.clearRect(0, 0, width, height);
  g.font = "12px Helvetica, Arial, sans-serif";
  g.lineWidth = 1; // a hairline costs a fifth of a wider one
  return { g, width, height };
}

export function write(g, text, x, y, align = "center", fill = ink.muted) {
  Object.assign(g, { fillStyle: fill, textAlign: align });
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

function stroked(g, stroke, dash, trace) {
  g.setLineDash(dash);
  g.strokeStyle = stroke;
  g.beginPath();
  trace();
  g.stroke();
}

export const path = (g, count, x, y, stroke, dash = []) => stroked(g, stroke, dash, () => {
  for (let i = 0; i < count; i += 1) g.lineTo(x(i), y(i));
});

export const circle = (g, x, y, radius, stroke, dash = []) =>
  stroked(g, stroke, dash, () => g.arc(x, y, radius, 0, 2 * Math.PI));

export const [LEFT, RIGHT] = [62, 8]; // of a curve's axes [px]

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

// values a step apart from 0 on; axes: {x: [low, high], y: [low, high], log: whether y is, names, units,
// marks}
export function curve(element, values, step, axes) {
  const { g, width, height } = begin(element);
  const [left, right, top, bottom] = [LEFT, RIGHT, 8, 34];
  const scale = (range, log, from, to) => {
    const f = log ? (v) => Math.log10(Math.max(v, 1e-30)) : (v) => v;
    const [low, high] = range.map(f);
    return (v) => from + ((f(v) - low) / (high - low || 1)) * (to - from);
  };
  const X = scale(axes.x, false, left, width - right);
  const Y = scale(axes.y, axes.log, height - bottom, top);
  ticks(axes.x, false, (width - left) / 80).forEach((v) => {
    path(g, 2, () => X(v), (i) => [top, height - bottom][i], ink.faint);
    write(g, short(v, axes.units[0]), Math.min(X(v), width - 24), height - bottom + 14);
  });
  ticks(axes.y, axes.log, (height - bottom) / 30).forEach((v) => {
    path(g, 2, (i) => [left, width - right][i], () => Y(v), ink.faint);
    write(g, short(v, axes.units[1]), left - 5, Y(v) + 4, "right");
  });
  write(g, axes.names[0], (left + width) / 2, height - 4);
  write(g, axes.names[1], left + 5, top + 12, "left");
  g.save();
  g.beginPath();
  g.rect(left, top, width - left - right, height - top - bottom);
  g.clip();
  for (const value of axes.marks || []) path(g, 2, () => X(value), (i) => i * height, ink.limit, [2, 3]);
  path(g, values.length, (i) => X(i * step), (i) => Y(values[i]), ink.line);
  g.restore();
}

function ticks([low, high], log, room) {
  if (log) {
    const decades = [];
    const [from, to] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
    for (let p = from; p <= to; p += Math.ceil((to - from + 1) / room)) decades.push(10 ** p);
    return decades.length > 1 ? decades : [low, high];
  }
  const step = rounded((high - low) / room);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
}
