// One signal over time from a trigger on, its spectrum, and spectra one below the other.
import { begin, canvas, curves, ink, rounded, series } from "/static/plot.js";
import { choice, make } from "/static/page.js";

const KEPT = 8192; // samples
const LINES = 2048; // samples of a spectrum

// amplitudes of a real signal by Cooley and Tukey's radix 2 (1965), Hann's window, peak values
export function spectrum(signal) {
  const n = signal.length;
  const re = new Float64Array(n);
  const im = new Float64Array(n);
  const mean = signal.reduce((sum, v) => sum + v, 0) / n;
  for (let i = 0, j = 0; i < n; i += 1) {
    re[j] = (signal[i] - mean) * (1 - Math.cos((2 * Math.PI * i) / n)); // gain 2 of 1/2 * 2
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j |= bit;
  }
  for (let size = 2; size <= n; size *= 2) {
    for (let k = 0; k < size / 2; k += 1) {
      const c = Math.cos((2 * Math.PI * k) / size);
      const s = -Math.sin((2 * Math.PI * k) / size);
      for (let a = k; a < n; a += size) {
        const b = a + size / 2;
        const x = re[b] * c - im[b] * s;
        const y = re[b] * s + im[b] * c;
        [re[b], im[b]] = [re[a] - x, im[a] - y];
        [re[a], im[a]] = [re[a] + x, im[a] + y];
      }
    }
  }
  return Float64Array.from({ length: n / 2 }, (_, i) => (2 * Math.hypot(re[i], im[i])) / n);
}

export function scope(rig) {
  const time = canvas("The signal over time", 180);
  const lines = canvas("Its spectrum", 180);
  const fall = canvas("Spectra one below the other, the newest on top", 150);
  const kept = new Float32Array(KEPT);
  const shown = { column: rig.columns.length - rig.axes.length, span: 0.1, trigger: "rising" };
  let [filled, expected, last] = [0, 0, 0];
  const reset = (change) => { Object.assign(shown, change); filled = 0; };
  const top = Math.min(LINES / 2, Math.max(100, Math.round((LINES * rig.dt * 3 * rig.speed) / 6)));
  const panel = make("section", { className: "panel" }, make("h2", {}, "Scope"),
    make("div", { className: "buttons" },
      choice("Signal", rig.columns, (name) => reset({ column: rig.columns.indexOf(name) }),
        rig.columns[shown.column]).label,
      choice("Seconds", ["0.02", "0.1", "0.4"], (span) => reset({ span: Number(span) }), "0.1").label,
      choice("Trigger", ["rising", "free"], (trigger) => reset({ trigger }), "rising").label),
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
    let [low, high] = [Infinity, -Infinity];
    for (const v of y) { low = Math.min(low, v); high = Math.max(high, v); }
    const half = rounded(Math.max((high - low) / 2, 1e-8));
    const middle = Number.isFinite(low) ? (low + high) / 2 : 0;
    const x = Float64Array.from(y, (_, i) => i * rig.dt);
    curves(time, [{ x, y, stroke: series()[0] }], { x: [0, shown.span],
      y: [middle - half, middle + half], names: ["time [s]", `[${unit}]`] });
    if (filled < LINES) return;
    const amplitudes = spectrum(kept.slice(filled - LINES, filled)).slice(0, top);
    const f = Float64Array.from(amplitudes, (_, i) => i / (LINES * rig.dt));
    const peak = rounded(Math.max(...amplitudes, 1e-8));
    curves(lines, [{ x: f, y: amplitudes, stroke: series()[0] }], { x: [0, f[f.length - 1]],
      y: [peak / 1e4, peak], log: [false, true], marks: [head.speed / (2 * Math.PI)],
      names: [`frequency [Hz]; dotted: the speed`, `peak [${unit}]`] });
    waterfall(amplitudes, peak);
  }

  function waterfall(amplitudes, peak) {
    const scale = fall.width || 1;
    const copy = document.createElement("canvas");
    copy.width = scale;
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
