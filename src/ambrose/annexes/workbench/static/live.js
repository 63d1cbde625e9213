// The live rig: orbits that one knocks, currents against their limits, what can be turned and broken.
import { make, replace, say, titled } from "/static/page.js";
import { form, sameAs } from "/static/controls.js";
import { begin, canvas, circle, extent, ink, path, rounded, short, write } from "/static/plot.js";
import { scope } from "/static/scope.js";
import { stream } from "/static/stream.js";

const POINTS = 480; // of an orbit that are drawn

export function live(place) {
  place.append(make("p", {}, "Connecting to the rig …"));
  let view = null;
  const act = (action, values) => link.send({ do: action, value: values[action], ...values });
  const link = stream({
    frame: (head, samples) => view?.show(head, samples),
    lost: (text) => say(text, true),
    told: (message) => {
      if (message.rig) { view = build(place, message.rig, act); say(""); }
      else if (message.building) say("Starting the rig; the first time it is compiled, which takes a minute.");
      else say(message.failed || message.refused, true);
      if (message.failed && !view) place.replaceChildren(titled("There is no rig", form(message.start, act)));
    } });
  return () => link.close();
}

function build(place, rig, act) {
  const orbits = rig.stations.map((station, s) => orbit(rig, station, s, act));
  const currents = canvas("Control currents in the coils, against their limits", 34 * rig.axes.length);
  const [watch, facts] = [scope(rig), make("p", { className: "facts" })];
  const forms = rig.controls.map((block) => form(block, act));
  const panel = make("aside", { className: "panel" },
    ...rig.controls.flatMap((block, i) => [make("h2", {}, block.title), forms[i]]), sameAs(rig.same));
  replace(place.firstElementChild, make("div", { className: "split" }, make("div", {},
    titled(`${rig.machine}: live rig`, facts,
      make("div", { className: "tiles" }, ...orbits.map((o) => o.figure)),
      make("p", { className: "muted" },
        "Click an orbit to knock the rotor there, in that direction; with the keyboard, arrow keys.")),
    titled("Control currents", currents), watch.panel), panel));
  let [drawn, since, rate, told] = [0, -1, 0, -1]; // by the clock of the rig, which comes with a frame
  const trail = []; // samples of the frames before, the newest at the end
  return { show: (head, samples) => {
    drawn += 1;
    const now = head.clock;
    if (now - since > 1) [rate, drawn, since] = [drawn / (now - since), 0, now];
    if (samples.length || !trail.length) trail.push(samples);
    if (trail.length > 6) trail.shift();
    const fresh = told < 0 || now - told > 0.199; // words change five times a second
    orbits.forEach((o) => o.show(head, trail, fresh));
    if (samples.length && !currents.away) bars(currents, rig, samples);
    watch.add(head, samples);
    watch.draw(head);
    if (!fresh) return;
    told = now;
    forms.forEach((element) => { element.set(head.set); element.able(head.able); });
    const words = { ...head.facts, frames: `${rate.toFixed(0)} a second` };
    const verdict = make("b", { className: head.warnings ? "bad" : "good" },
      head.warnings || "the rotor levitates");
    facts.replaceChildren(verdict, ...Object.entries(words).map(([name, text]) =>
      make("span", {}, `${name} `, make("b", {}, text))));
  } };
}

function orbit(rig, station, s, act) {
  const [element, caption] = [canvas(`Orbit at ${station}; click to knock`), make("figcaption", {})];
  element.tabIndex = 0;
  const [gap, columns] = [rig.gaps[s], rig.columns.length];
  let [arrow, strength, reach, clock] = [null, 0, rig.scale, 0];
  const knock = (x, y) => {
    arrow = { x, y, until: clock + 0.25 };
    act("knock", { station, x: x * strength, y: y * strength });
  };
  element.addEventListener("pointerdown", (event) => {
    knock((2 * event.offsetX) / element.clientWidth - 1, 1 - (2 * event.offsetY) / element.clientHeight);
  });
  const keys = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  element.addEventListener("keydown", (event) => {
    if (keys[event.key]) { event.preventDefault(); knock(...keys[event.key]); }
  });
  function show(head, trail, fresh) {
    if (element.away) return;
    const newest = trail[trail.length - 1];
    let most = 0;
    for (let k = 2 * s; k < newest.length; k += columns)
      most = Math.max(most, Math.hypot(newest[k], newest[k + 1]));
    const full = 1.15 * (gap || Math.max(rig.scale, most));
    reach = head.set.near ? Math.min(full, Math.max(rounded(1.2 * most), reach * 0.98, full / 200)) : full;
    [strength, clock] = [head.set.strength, head.clock];
    const { g, width } = begin(element);
    const [half, unit] = [width / 2, (width / 2 - 4) / reach];
    path(g, 2, (i) => [0, width][i], () => half, ink.faint);
    path(g, 2, () => half, (i) => [0, width][i], ink.faint);
    for (const [i, [zone, share]] of Object.entries(s < rig.bearings ? rig.zones : {}).entries()) {
      const [radius, turn] = [share * rig.scale * unit, 1.2 - 0.6 * i]; // names apart from each other
      if (radius < 1.4 * half) circle(g, half, half, radius, ink.warm, [4, 4]);
      if (radius < half && radius > 20) write(g, zone, half + (radius + 6) * Math.cos(turn),
        half - (radius + 6) * Math.sin(turn) + 4);
    }
    if (gap && gap * unit < 1.4 * half) circle(g, half, half, gap * unit, ink.limit);
    // two dozen points of a turn are enough
    const stride = columns * Math.min(4, Math.max(1, Math.floor(0.26 / (rig.dt * (head.speed + 1)))));
    let left = POINTS;
    for (let age = trail.length - 1; age >= 0 && left > 0; age -= 1) {
      const old = trail[age];
      const end = old.length - columns + 2 * s;
      const count = Math.min(left, Math.ceil(old.length / stride));
      g.globalAlpha = left / POINTS;
      path(g, count, (k) => half + unit * old[end - k * stride],
        (k) => half - unit * old[end - k * stride + 1], ink.line);
      left -= count;
    }
    g.globalAlpha = 1;
    const end = newest.length - columns + 2 * s; // where it is now, also when it stands still
    if (end >= 0) circle(g, half + unit * newest[end], half - unit * newest[end + 1], 2, ink.line);
    if (arrow && head.clock < arrow.until) {
      g.lineWidth = 3;
      path(g, 2, (i) => half + i * arrow.x * half, (i) => half - i * arrow.y * half, ink.line2);
    }
    const bar = rounded(reach / 5); // the scale of this station
    g.lineWidth = 2;
    path(g, 2, (i) => 8 + i * bar * unit, () => width - 8, ink.ink);
    write(g, short(bar, "m"), 8, width - 13, "left", ink.ink);
    if (!fresh) return;
    const size = `${short(most, "m")}${head.contact[s] ? ", touching" : ""}`;
    const textContent = `${station}: ${size}${gap ? `; touchdown gap ${short(gap, "m")}` : ""}`;
    Object.assign(caption, { textContent, className: head.contact[s] ? "bad" : "" });
  }
  return { figure: make("figure", {}, element, caption), show };
}

function bars(element, rig, samples) {
  const { g, width } = begin(element);
  rig.axes.forEach((axis, a) => {
    const most = rig.limits[a] || 1;
    const [low, high] = extent(samples, rig.currents[a], rig.columns.length);
    const [least, largest] = extent(samples, rig.commands[a], rig.columns.length);
    const [y, half] = [34 * a + 20, (width - 24) / 2];
    const X = (v) => 12 + half * (1 + Math.max(-1.02, Math.min(1.02, v / most)));
    const full = Math.max(-least, largest) >= 0.999 * most;
    g.fillStyle = ink.faint;
    g.fillRect(12, y, 2 * half, 10);
    g.fillStyle = full ? ink.limit : ink.line;
    g.fillRect(X(low), y, Math.max(X(high) - X(low), 2), 10);
    path(g, 2, () => X(0), (i) => y - 2 + 14 * i, ink.muted);
    const limit = rig.limits[a] ? `of ±${short(most, "A")}${full ? ", at the limit" : ""}` : "no limit";
    write(g, `${axis}: ${low.toFixed(2)} to ${high.toFixed(2)} A ${limit}`, 12, y - 5, "left", ink.ink);
  });
}
