// One signal over time from a trigger on, its spectrum, and spectra one below the other.
import { form } from "/static/controls.js";
import { LEFT, RIGHT, canvas, curve, extent, ink, rounded } from "/static/plot.js";
import { titled } from "/static/page.js";

const KEPT = 8192; // samples
const LINES = 2048; // samples of a spectrum

// amplitudes of the first lines of a signal by Goertzel's recursion (1958), Hann's window, peak values
export function spectrum(signal, lines) {
  const [n, w] = [signal.length, (i) => 1 - Math.cos((2 * Math.PI * i) / signal.length)];
  const mean = signal.reduce((sum, v, i) => sum + v * w(i), 0) / n; // weighed, else a line at 0 Hz is left
  const x = Float64Array.from(signal, (v, i) => (v - mean) * w(i));
  return Float64Array.from({ length: lines }, (_, k) => {
    const c = 2 * Math.cos((2 * Math.PI * k) / n);
    let [a, b] = [0, 0];
    for (const v of x) { const next = v + c * a - b; b = a; a = next; }
    return (2 * Math.sqrt(Math.max(a * a + b * b - c * a * b, 0))) / n;
  });
}

export function scope(rig) {
  const time = canvas("The signal over time", 180);
  const lines = canvas("Its spectrum", 180);
  const fall = canvas("Spectra one below the other, the newest on top", 150);
  const none = new Float32Array(0);
  const chosen = form(rig.scope, () => { kept = none; });
  let [shown, kept, expected, last, seen] = [{}, none, 0, -1, -1];
  const top = Math.min(LINES / 2, Math.max(100, Math.round((LINES * rig.dt * 3 * rig.speed) / 6)));
  const panel = titled(rig.scope.title, chosen, time, lines, fall);

  function add(head, samples) {
    const [columns, count] = [rig.columns.length, samples.length / rig.columns.length];
    shown = chosen.values();
    // a frame that was dropped leaves a gap
    if (Math.abs(head.time - count * rig.dt - expected) > rig.dt / 2) kept = none;
    expected = head.time;
    const before = kept.subarray(Math.max(0, kept.length + count - KEPT));
    kept = new Float32Array(before.length + count);
    kept.set(before);
    const column = rig.columns.indexOf(shown.signal);
    for (let k = 0; k < count; k += 1) kept[before.length + k] = samples[k * columns + column];
  }

  function draw(head) {
    if (!kept.length || head.clock - last < 0.09 || (time.away && lines.away && fall.away)) return;
    last = head.clock;
    const unit = /^[ui] /.test(shown.signal) ? "A" : "m";
    const width = Math.min(Math.round(Number(shown.span) / rig.dt), kept.length);
    let start = kept.length - width;
    if (shown.trigger === "rising") {
      const level = kept.reduce((sum, v) => sum + v, 0) / kept.length;
      for (let i = start; i > 0; i -= 1) if (kept[i - 1] < level && kept[i] >= level) { start = i; break; }
    }
    const y = kept.subarray(start, start + width);
    const [low, high] = extent(y);
    const [middle, half] = [(low + high) / 2, rounded(Math.max((high - low) / 2, 1e-8))];
    curve(time, y, rig.dt, { x: [0, Number(shown.span)],
      y: [middle - half, middle + half], names: ["time", shown.signal], units: ["s", unit] });
    if (kept.length < LINES || last - seen < 0.24) return;
    seen = last;
    const amplitudes = spectrum(kept.subarray(-LINES), top);
    const [step, peak] = [1 / (LINES * rig.dt), rounded(Math.max(...amplitudes, 1e-8))];
    curve(lines, amplitudes, step, { x: [0, step * (top - 1)],
      y: [peak / 1e4, peak], log: true, marks: [head.speed / (2 * Math.PI)],
      names: ["frequency; dotted: the running speed", `${shown.signal}, peak`], units: ["Hz", unit] });
    waterfall(amplitudes, peak);
  }

  function waterfall(amplitudes, peak) {
    const { width, height } = fall.room || fall;
    if (fall.width !== Math.round(width)) [fall.width, fall.height] = [Math.round(width), Math.round(height)];
    const g = fall.getContext("2d");
    Object.assign(g, { globalAlpha: 1, globalCompositeOperation: "copy" });
    g.drawImage(fall, 0, 3);
    g.globalCompositeOperation = "source-over";
    g.fillStyle = ink.line;
    for (let p = LEFT; p < width - RIGHT; p += 2) {
      const line = (at) => Math.round(((at - LEFT) / (width - LEFT - RIGHT)) * (amplitudes.length - 1));
      const [from, to] = [line(p), Math.max(line(p + 2), line(p) + 1)];
      const level = 1 + Math.log10(Math.max(extent(amplitudes.subarray(from, to))[1], 1e-30) / peak) / 3;
      g.globalAlpha = Math.min(Math.max(level, 0), 1);
      g.fillRect(p, 0, 2, 3);
    }
  }
  return { panel, add, draw };
}
