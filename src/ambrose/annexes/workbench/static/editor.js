// What is edited in rows, with undo: the filters of a controller with their handles on its Bode figures,
// and a grid of cells (grid.js). A change makes a new document, so that the ones before stay as they were.
import { button, make, replace } from "/static/page.js";

// the documents there were, of which one is shown; changed: what follows, told whether a field was typed in
export function memory(first, changed) {
  let [history, at] = [[first], 0];
  const now = () => history[at];
  const step = (way) => { put(history, Math.min(Math.max(at + way, 0), history.length - 1)); changed(); };
  const buttons = [button("Undo", () => step(-1)), button("Redo", () => step(1))];
  const put = (all, place = all.length - 1) => {
    [history, at] = [all, place];
    [buttons[0].disabled, buttons[1].disabled] = [at === 0, at === all.length - 1];
  };
  const add = (made, again) => put([...history.slice(0, again ? at : at + 1), made]);
  // from: the document that is changed; again: in place of the newest one, as while a handle moves
  const edit = (change, from = now(), again = false, typed = false) => {
    const made = structuredClone(from);
    change(made);
    add(made, again);
    changed(typed);
  };
  const keys = (event) => { // where no field has an undo of its own
    const [key, field] = [event.key.toLowerCase(), event.target];
    if (!(event.ctrlKey || event.metaKey) || !"zy".includes(key)) return;
    if (field.type === "text" && field.value !== field.defaultValue) return;
    event.preventDefault();
    step(key === "y" || event.shiftKey ? 1 : -1);
  };
  put(history);
  return { now, add, edit, keys, buttons };
}

// a small button of a row
export const small = (text, title, act, disabled) => button(text, act, { ariaLabel: title, title, disabled });

let held = null; // the editor of the page, which handles turn

const HANDLE_STEP = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const WAYS = { // of a handle that moves: a value, factors of frequency and magnitude, a power, an angle [rad]
  x: (v, kx, ky, power) => v * kx ** power,
  y: (v, kx, ky, power) => Math.max(v, 1e-3) * ky ** power,
  width: (v, kx) => Math.max(Math.sinh(Math.asinh(v) + Math.log(kx)), 1e-4), // edge w (d + sqrt(1 + d^2))
  phase: (v, kx, ky, power, angle) => Math.min(Math.max(v + angle, -2.9), 2.9),
  scale: (v, kx) => v.map((c, i) => c / kx ** (v.length - 1 - i)), // coefficients of falling powers
};

export function chains(block, act) {
  let [opened, rows] = [block.document, make("div", {})];
  const ask = () => { show(); act(block.live, {}, true); };
  const past = memory(block.document, ask);
  const { now, edit } = past;
  const element = make("div", { onkeydown: past.keys }, make("p", { className: "muted" }, block.hint),
    make("div", { className: "buttons" }, ...past.buttons), rows);
  const show = () => {
    const fresh = make("div", { className: "chains" }, ...now().channel.map(chain));
    replace(rows, fresh);
    rows = fresh;
  };

  const entry = (name, [key, label, unit, factor], part) => {
    const value = part[key];
    const shown = (v) => Number((v * factor).toPrecision(7));
    const text = value === undefined ? "" : [value].flat().map(shown).join(" ");
    const beside = make("small", { className: "bad" });
    const input = make("input", { type: "text", name: `${name}.${key}`, defaultValue: text });
    input.addEventListener("change", () => {
      const numbers = input.value.trim().replaceAll(",", ".").split(/\s+/).filter(Boolean).map(Number);
      const many = Array.isArray(value);
      const bad = numbers.some((v) => !Number.isFinite(v)) || (!many && numbers.length > 1);
      input.ariaInvalid = bad;
      beside.textContent = bad ? `${input.value} is ${many ? "no list of numbers" : "no number"}` : "";
      if (bad) return;
      edit((all) => {
        const place = name.split(".").reduce((inner, next) => inner[next], all);
        if (!numbers.length) delete place[key];
        else place[key] = many ? numbers.map((v) => v / factor) : numbers[0] / factor;
      });
    });
    return make("label", {}, make("span", {}, label, unit && ` [${unit}]`), input, beside);
  };
  const row = (c, section, r, all) => {
    const title = `${section.kind} ${r + 1}`;
    const swap = (other) => edit((made) => {
      const list = made.channel[c].section;
      [list[r], list[other]] = [list[other], list[r]];
    });
    const of = `${title}, ${now().channel[c].names}`;
    return make("section", {}, make("div", { className: "buttons" }, make("b", {}, title),
      small("↑", `Earlier: ${of}`, () => swap(r - 1), r === 0),
      small("↓", `Later: ${of}`, () => swap(r + 1), r === all.length - 1),
      small("✕", `Delete ${of}`, () => edit((made) => { made.channel[c].section.splice(r, 1); }))),
    ...block.kinds[section.kind].map((known) => entry(`channel.${c}.section.${r}`, known, section)));
  };
  const chain = (channel, c) => {
    const add = make("select", { ariaLabel: `Add a filter to ${channel.names}` },
      ...["Add a filter …", ...Object.keys(block.kinds)].map((text) => make("option", {}, text)));
    add.addEventListener("change", () => edit((made) => {
      const first = Object.fromEntries(block.kinds[add.value].map(([key, , , , value]) => [key, value]));
      (made.channel[c].section ??= []).push({ kind: add.value, ...first });
    }));
    const apart = () => edit((made) => made.channel.splice(c, 1,
      ...channel.names.map((name) => ({ ...structuredClone(channel), names: [name] }))));
    return make("div", {}, make("h3", {}, channel.names.join(", ")),
      entry(`channel.${c}`, ["gain", "gain", "A/mm", 1e-3], channel),
      ...(channel.section || []).map((section, r, all) => row(c, section, r, all)),
      make("div", { className: "buttons" }, add,
        channel.names.length > 1 ? button("One chain for each", apart) : null));
  };

  element.values = () => ({ chains: now(), opened });
  element.take = (told) => { // another controller is opened; what was edited before is one undo away
    if (!told.fresh) return;
    past.add(opened = told.document);
    show();
  };
  held = past;
  show();
  return element;
}

// a handle on a figure; step: px of a decade of frequency, and of one upwards
export function handle(spec, step) {
  const dot = button("", () => {}, { className: "handle", ariaLabel: spec.label, title: spec.label });
  const put = (target, x, y) => Object.assign(target.style, { left: `${x}px`, top: `${y}px` });
  const part = (made) => {
    const channel = made.channel[spec.channel];
    return spec.row < 0 ? channel : channel?.section?.[spec.row];
  };
  const turn = (from, dx, dy, again) => {
    // of a row that went while the figure was still that of before
    if (!spec.terms.every(([key]) => part(from)?.[key] !== undefined)) return;
    const [kx, ky, angle] = [10 ** (dx / step[0]), 10 ** (-dy / step[1]), (-dy / step[1]) * (Math.PI / 180)];
    held.edit((made) => {
      for (const [key, way, power] of spec.terms)
        part(made)[key] = WAYS[way](part(made)[key], kx, ky, power, angle);
    }, from, again);
  };
  put(dot, spec.x, spec.y);
  dot.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    dot.focus();
    const from = held.now();
    let moved = false;
    const move = (now) => {
      const [dx, dy] = [now.clientX - event.clientX, now.clientY - event.clientY];
      if (!moved && Math.hypot(dx, dy) < 2) return;
      turn(from, dx, dy, moved);
      moved = true;
      // at once, also on a figure that was drawn anew meanwhile
      if (document.activeElement.className === "handle") put(document.activeElement, spec.x + dx, spec.y + dy);
    };
    const end = new AbortController();
    window.addEventListener("pointermove", move, { signal: end.signal });
    for (const name of ["pointerup", "pointercancel"])
      window.addEventListener(name, () => end.abort(), { signal: end.signal });
  });
  dot.addEventListener("keydown", (event) => {
    held.keys(event);
    if (!HANDLE_STEP[event.key]) return;
    event.preventDefault();
    const [dx, dy] = HANDLE_STEP[event.key].map((way) => way * (event.shiftKey ? 10 : 1));
    turn(held.now(), dx, dy, false);
  });
  return dot;
}
