// The live rig: orbits that one knocks, currents against their limits, what can be turned and broken.
import { button, choice, make, say, sameAs, slider } from "/static/page.js";
import { begin, canvas, circle, ink, path, rounded, series, short } from "/static/plot.js";
import { scope } from "/static/scope.js";
import { stream } from "/static/stream.js";

const TURN = 2 * Math.PI;

export function live(place, state) {
  place.append(make("p", {}, "Connecting to the rig …"));
  let view = null;
  const link = stream({
    rig: (rig) => { view = build(place, rig, state, (message) => link.send(message)); say(""); },
    frame: (head, samples, columns) => view?.show(head, samples, columns),
    lost: (text) => say(text, true),
    told: (message) => {
      if (message.building) say("Starting the rig; the first time it is compiled, which takes a minute.");
      else if (message.failed) failed(message.failed);
      else say(message.refused, true);
    } });
  const failed = (text) => {
    say(text, true);
    if (!view) place.replaceChildren(make("section", { className: "panel" }, make("h2", {}, "There is no rig"),
      starting(state.files.controllers, (message) => link.send(message))));
  };
  return () => link.close();
}

function starting(names, send) {
  const { list, label } = choice("Controller", names, () => {});
  const start = (initial) => () => send({ do: "restart", controller: list.value, initial });
  return make("div", { className: "buttons" }, label, button("Start levitated", start("levitated")),
    button("Start on the touchdown bearings", start("resting")));
}

function build(place, rig, state, send) {
  const orbits = rig.stations.map((station, s) => orbit(rig, station, s, send));
  const currents = canvas("Control currents of every axis against their limits", 34 * rig.axes.length);
  const watch = scope(rig);
  const facts = make("p", { className: "facts" });
  const controls = panel(rig, state, send, orbits);
  place.replaceChildren(make("div", { className: "split" }, make("div", {},
      make("section", { className: "panel" }, make("h2", {}, `${rig.machine}: live rig`), facts,
        make("div", { className: "tiles" }, ...orbits.map((o) => o.figure)),
        make("p", { className: "muted" },
          "Click an orbit to knock the rotor there, in that direction; with the keyboard, arrow keys.")),
      make("section", { className: "panel" }, make("h2", {}, "Control currents"), currents),
      watch.panel), controls.panel));
  let [drawn, since, rate] = [0, performance.now(), 0];
  return {
    show: (head, samples, columns) => {
      drawn += 1;
      const now = performance.now();
      if (now - since > 1000) [rate, drawn, since] = [(1000 * drawn) / (now - since), 0, now];
      orbits.forEach((o) => o.show(head, samples, columns));
      if (samples.length) bars(currents, rig, samples, columns);
      watch.add(head, samples, columns);
      watch.draw(head);
      controls.show(head);
      told(facts, rig, head, rate);
    }, };
}

function told(facts, rig, head, rate) {
  const words = {
    time: `${head.time.toFixed(1)} s`, speed: `${((head.speed / TURN) * 60).toFixed(0)} rpm`,
    ...(rig.seals.length ? { pressure: `${(head.pressure / 1e5).toFixed(2)} bar` } : {}),
    controller: head.controller, "real time": `${head.realtime.toFixed(2)} ×`,
    frames: `${rate.toFixed(0)} a second`, };
  facts.replaceChildren(...Object.entries(words).map(([name, text]) =>
    make("span", {}, `${name} `, make("b", {}, text))));
  const warnings = [head.ended, head.contact.some(Boolean) && "the rotor touches its touchdown bearings",
    head.failed.length && `failed: ${head.failed.join(", ")}`,
    head.stale && "the machine file has changed: start again to see it"].filter(Boolean);
  if (warnings.length) facts.append(make("b", { className: "bad" }, warnings.join("; ")));
}

function orbit(rig, station, s, send) {
  const element = canvas(`Orbit at ${station}; click to knock`);
  element.tabIndex = 0;
  const caption = make("figcaption", {});
  const own = { near: true, strength: rig.impulse, reach: rig.scale };
  const gap = rig.gaps[s];
  const trail = [];
  let arrow = null;
  const knock = (x, y) => {
    arrow = { x, y, until: performance.now() + 250 };
    send({ do: "knock", station, x: x * own.strength, y: y * own.strength });
  };
  element.addEventListener("pointerdown", (event) => {
    const box = element.getBoundingClientRect();
    knock((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
  });
  const keys = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  element.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    event.preventDefault();
    knock(...keys[event.key]);
  });
  function show(head, samples, columns) {
    const count = samples.length / columns;
    if (count) trail.push(samples);
    if (trail.length > 5) trail.shift();
    let most = 0;
    const newest = trail[trail.length - 1] || samples;
    for (let k = 2 * s; k < newest.length; k += columns)
      most = Math.max(most, Math.hypot(newest[k], newest[k + 1]));
    const full = 1.15 * (gap || Math.max(rig.scale, most));
    own.reach = own.near ? Math.min(full, Math.max(rounded(1.2 * most), own.reach * 0.98, full / 200)) : full;
    const { g, width } = begin(element);
    const half = width / 2;
    const unit = (half - 4) / own.reach;
    path(g, 2, (i) => [0, width][i], () => half, ink.faint);
    path(g, 2, () => half, (i) => [0, width][i], ink.faint);
    g.fillStyle = ink.muted;
    g.textAlign = "center";
    for (const [zone, share] of Object.entries(s < rig.bearings ? rig.zones : {})) {
      const radius = share * rig.scale * unit;
      circle(g, half, half, radius, ink.warm, [4, 4]);
      if (radius < half && radius > 20) g.fillText(zone, half + 0.707 * radius, half - 0.707 * radius + 4);
    }
    if (gap) circle(g, half, half, gap * unit, ink.limit);
    trail.forEach((old, age) => {
      g.globalAlpha = (age + 1) / trail.length;
      path(g, old.length / columns, (k) => half + unit * old[k * columns + 2 * s],
        (k) => half - unit * old[k * columns + 2 * s + 1], ink.line);
    });
    g.globalAlpha = 1;
    const end = newest.length - columns + 2 * s; // where it is now, also when it stands still
    if (end >= 0) circle(g, half + unit * newest[end], half - unit * newest[end + 1], 2, ink.line);
    if (arrow && performance.now() < arrow.until) {
      g.lineWidth = 3;
      path(g, 2, (i) => half + i * arrow.x * half, (i) => half - i * arrow.y * half, ink.line2);
    }
    const touched = head.contact[s] ? ", touching" : "";
    caption.textContent = `${station}: ${short(most, "m")}${touched}; circle ${short(own.reach, "m")}`;
    caption.className = head.contact[s] ? "bad" : "";
  }
  return { figure: make("figure", {}, element, caption), show, own };
}

function bars(element, rig, samples, columns) {
  const { g, width } = begin(element);
  const first = 2 * rig.stations.length;
  rig.axes.forEach((axis, a) => {
    const most = rig.limits[a] || 1;
    let [low, high] = [Infinity, -Infinity];
    for (let k = first + a; k < samples.length; k += columns) {
      low = Math.min(low, samples[k]);
      high = Math.max(high, samples[k]);
    }
    const y = 34 * a + 20;
    const half = (width - 24) / 2;
    const X = (v) => 12 + half * (1 + Math.max(-1.02, Math.min(1.02, v / most)));
    const full = Math.max(-low, high) >= 0.999 * most;
    g.fillStyle = ink.faint;
    g.fillRect(12, y, 2 * half, 10);
    g.fillStyle = full ? ink.limit : series()[0];
    g.fillRect(X(low), y, Math.max(X(high) - X(low), 2), 10);
    path(g, 2, () => X(0), (i) => y - 2 + 14 * i, ink.muted);
    g.fillStyle = ink.ink;
    g.textAlign = "left";
    const limit = rig.limits[a] ? `of ±${short(most, "A")}${full ? ", at the limit" : ""}` : "no limit";
    g.fillText(`${axis}: ${low.toFixed(2)} to ${high.toFixed(2)} A ${limit}`, 12, y - 5);
  });
}

function panel(rig, state, send, orbits) {
  const rpm = (v) => `${((v / TURN) * 60).toFixed(0)} rpm`;
  const speed = slider("Speed", [0, rig.speed, rig.speed / 500], 0, rpm,
    (value) => send({ do: "speed", value }));
  const pressure = slider("Seal pressure", [0, rig.pressure || 1, (rig.pressure || 1) / 500], 0,
    (v) => `${(v / 1e5).toFixed(2)} bar`, (value) => send({ do: "pressure", value }));
  const where = choice("Unbalance at", rig.stations, () => push());
  const unbalance = slider("Unbalance", [0, rig.unbalance, rig.unbalance / 200], 0,
    (v) => `${(v * 1e6).toPrecision(3)} g mm`, () => push());
  const push = () => send({ do: "unbalance", station: where.list.value, value: Number(unbalance.input.value) });
  const gain = slider("Gain of the controller", [-1, 1, 0.01], 0, (v) => `${(10 ** v).toFixed(2)} ×`,
    (v) => send({ do: "gain", value: 10 ** v }));
  const strength = slider("Strength of a knock", [-1.5, 1.5, 0.05], 0,
    (v) => short(rig.impulse * 10 ** v, "N s"),
    (v) => orbits.forEach((o) => { o.own.strength = rig.impulse * 10 ** v; }));
  const near = make("input", { type: "checkbox", checked: true });
  near.addEventListener("change", () => orbits.forEach((o) => { o.own.near = near.checked; }));
  const names = state.files.controllers;
  const takes = choice("Controller", names.length ? names : ["pid.json"], () => {});
  const pace = choice("Time", rig.paces, (name) => send({ do: "pace", pace: name }), "real");
  const axis = choice("Axis", rig.axes, () => {});
  const fail = (what) => () => send({ do: "fail", what, axis: axis.list.value });
  const excite = button("Excite", () => send({ do: "excite", value: excite.className ? 0 : rig.excitation }));
  const record = button("Record", () => send({ do: record.className ? "stop" : "record" }));
  const words = make("p", { className: "muted" });
  const file = (head) => (!head.record ? ""
    : `records/${head.record}${head.recorded === null ? "" : `: ${head.recorded.toFixed(1)} s`}`);
  return {
    panel: make("aside", { className: "panel" },
      make("h2", {}, "Turn"), speed.label, ...(rig.seals.length ? [pressure.label] : []),
      where.label, unbalance.label, gain.label, make("h2", {}, "Push"), strength.label,
      make("div", { className: "buttons" },
        button("Drop", () => send({ do: "drop" })), button("Lift", () => send({ do: "lift" })),
        pace.label, make("label", { className: "row" }, "Zoom in", near)), make("h2", {}, "Controller"),
      make("div", { className: "buttons" }, takes.label,
        button("Switch", () => send({ do: "switch", controller: takes.list.value }))),
      make("h2", {}, "Record"), make("div", { className: "buttons" }, excite, record), words,
      make("h2", {}, "Break"), make("div", { className: "buttons" }, axis.label,
        button("Sensor fails", fail("sensor")), button("Amplifier fails", fail("amplifier")),
        ...(rig.seals.length ? [button("Pressure sensor fails", fail("pressure"))] : [])),
      make("h2", {}, "Start again"), starting(names.length ? names : ["pid.json"], send),
      sameAs({ Python: ["import ambrose as amb", "from ambrose.rig.live import LiveRig",
        'machine, law = amb.load_machine("machine.toml"), amb.read_controller("controllers/pid.json")',
        "live = LiveRig(machine, law)", "frame = live.advance(1000)"].join("\n") })),
    show: (head) => {
      speed.set(head.targets.speed);
      pressure.set(head.targets.pressure);
      gain.set(Math.log10(head.gain));
      if (head.unbalance[0]) where.list.value = head.unbalance[0];
      unbalance.set(head.unbalance[1]);
      if (pace.list.value !== head.pace) pace.list.value = head.pace;
      excite.className = head.excited ? "on" : "";
      excite.textContent = head.excited ? "Stop exciting" : "Excite";
      record.className = head.recorded !== null ? "on" : "";
      record.textContent = head.recorded !== null ? "Stop recording" : "Record";
      words.textContent = file(head);
    }, };
}
