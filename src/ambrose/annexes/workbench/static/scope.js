// One signal over time from a trigger on, its spectrum, and spectra one below the other.
import { field } from "/static/controls.js";
import { begin, canvas, curves, extent, ink, rounded, series } from "/static/plot.js";
import { make } from "/static/page.js";

const KEPT = 8192; // samples
const LINES = 2048; // samples of a spectrum

// amplitudes of the first lines of a signal by Goertzel's recursion (1958), Hann's window, peak values
export function spectrum(signal, lines) {
  const n = signal.length;
  const mean = signal.reduce((sum, v) => sum + v, 0) / n;
  const x = Float64Array.from(signal, (v, i) => (v - mean) * (1 - Math.cos((2 * Math.PI * i) / n)));
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
  const kept = new Float32Array(KEPT);
  const shown = { column: rig.columns.length - rig.axes.length, span: 0.1, trigger: "rising" };
  let [filled, expected, last] = [0, 0, 0];
  const choose = (label, options, at, change) => field({ name: label, label, kind: "choice", options,
    value: options[at] }, (value) => { Object.assign(shown, change(value)); filled = 0; }).label;
  const top = Math.min(LINES / 2, Math.max(100, Math.round((LINES * rig.dt * 3 * rig.speed) / 6)));
  const panel = make("section", { className: "panel" }, make("h2", {}, "Scope"),
    make("div", { className: "buttons" },
      choose("Signal", rig.columns, shown.column, (name) => ({ column: rig.columns.indexOf(name) })),
      choose("Seconds", ["0.02", "0.1", "0.4"], 1, (span) => ({ span: Number(span) })),
      choose("Trigger", ["rising", "free"], 0, (trigger) => ({ trigger }))),
    time, lines, fall);

  function add(head, samples, columns) {
    const count = samples.length / columns;
    // a frame that was dropped leaves a gap
    if (Math.abs(head.time - count * rig.dt - expected) > rig.dt / 2) filled = 0;
    expected = head.time;
    const fresh = Math.min(count, KEPT);
    if (filled + fresh > KEPT) {
      kept.copyWithin(0, filled + fresh - KEPT, filled);
      filled = KEPT - fresh;
    }
    for (let k = 0; k < fresh; k += 1) kept[filled + k] = samples[k * columns + shown.column];
    filled += fresh;
  }

  function draw(head) {
    if (performance.now() - last < 90) return;
    last = performance.now();
    const unit = /^[ui] /.test(rig.columns[shown.column]) ? "A" : "m";
    const width = Math.min(Math.round(shown.span / rig.dt), filled);
    let start = filled - width;
    if (shown.trigger === "rising") {
      const all = kept.subarray(0, filled);
      const level = all.reduce((sum, v) => sum + v, 0) / Math.max(filled, 1);
      for (let i = start; i > 0; i -= 1) if (kept[i - 1] < level && kept[i] >= level) { start = i; break; }
    }
    const y = kept.subarray(start, start + width);
    const [low, high] = extent(y);
    const half = rounded(Math.max((high - low) / 2, 1e-8));
    const middle = Number.isFinite(low) ? (low + high) / 2 : 0;
    const x = Float64Array.from(y, (_, i) => i * rig.dt);
    curves(time, [{ x, y, stroke: series()[0] }], { x: [0, shown.span],
      y: [middle - half, middle + half], names: ["time [s]", `[${unit}]`] });
    if (filled < LINES) return;
    const amplitudes = spectrum(kept.subarray(filled - LINES, filled), top);
    const f = Float64Array.from(amplitudes, (_, i) => i / (LINES * rig.dt));
    const peak = rounded(Math.max(...amplitudes, 1e-8));
    curves(lines, [{ x: f, y: amplitudes, stroke: series()[0] }], { x: [0, f[f.length - 1]],
      y: [peak / 1e4, peak], log: [false, true], marks: [head.speed / (2 * Math.PI)],
      names: [`frequency [Hz]; dotted: the speed`, `peak [${unit}]`] });
    waterfall(amplitudes, peak);
  }

  function waterfall(amplitudes, peak) {
    const copy = document.createElement("canvas");
    copy.width = fall.width || 1;
    copy.height = fall.height || 1;
    copy.getContext("2d").drawImage(fall, 0, 0);
    const { g, width, height } = begin(fall);
    g.drawImage(copy, 0, 2, width, height);
    g.fillStyle = ink.line;
    for (let p = 58; p < width - 8; p += 2) {
      const from = Math.floor(((p - 58) / (width - 66)) * amplitudes.length);
      const to = Math.max(Math.ceil(((p - 56) / (width - 66)) * amplitudes.length), from + 1);
      const level = 1 + Math.log10(Math.max(...amplitudes.slice(from, to), 1e-30) / peak) / 3;
      g.globalAlpha = Math.min(Math.max(level, 0), 1);
      g.fillRect(p, 0, 2, 2);
    }
    g.globalAlpha = 1;
  }
  return { panel, add, draw };
}
