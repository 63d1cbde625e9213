// Fields and buttons that the server describes (blocks.py), for all screens and the live rig.
import { ask, button, make, say, tried } from "/static/page.js";
import { short } from "/static/plot.js";

// act(action, values, live) is asked for what a button or a change wants
export function form(block, act) {
  const fields = block.fields.map((spec) => {
    const action = spec.action ?? block.live;
    return field(spec, () => action && act(action, values(), true), act);
  });
  const values = () => Object.fromEntries(fields.map((f) => [f.name, f.value?.()]));
  const buttons = block.buttons.map((b) => button(b.text, () => act(b.action, { ...values(), ...b.more }),
    { className: b.main ? "main" : "", disabled: Boolean(b.off), title: b.off || "" }));
  const element = make("div", {}, make("p", { className: "muted" }, block.hint),
    make("div", { className: "fields" }, ...fields.flatMap(({ label }, i) => (block.fields[i].heading
      ? [make("h3", {}, block.fields[i].heading), label] : [label]))),
    make("div", { className: "buttons" }, ...buttons), make("pre", { className: "log" }, block.log || ""));
  if (block.same) element.append(sameAs(block.same));
  element.values = values;
  element.tell = (told) => fields.forEach((f) => f.tell?.(told[f.name] || ""));
  // {text of a button: whether it can do anything now}
  element.able = (now) => buttons.forEach((b) => { b.disabled = now[b.textContent] === false; });
  element.set = (now) => fields.forEach((f) => { if (f.name in now) f.set?.(now[f.name]); });
  return element;
}

const TAGS = { area: "textarea", choice: "select" };
const TYPES = { check: "checkbox", file: "file", slider: "range" };

export function field(spec, change, act) {
  const { name, kind, log } = spec;
  const known = kind === "slider" ? { min: spec.low, max: spec.high, step: (spec.high - spec.low) / 400 } : {};
  if (!TAGS[kind]) known.type = TYPES[kind] || "text";
  const input = make(TAGS[kind] || "input", { name, ...known },
    ...(spec.options || []).map((text) => make("option", { value: text }, text)));
  if (kind === "file") return { label: drop(spec, input, act) };
  const [main, check] = [kind === "slider", kind === "check"];
  const beside = make(main ? "span" : "small", { className: main ? "value" : "bad" });
  const raw = check ? "checked" : "value";
  const value = () => (main ? (log ? 10 ** Number(input.value) : Number(input.value)) : input[raw]);
  const told = () => { if (main) beside.textContent = short(value() * (spec.factor || 1), spec.unit); };
  const put = (now) => { input[raw] = main && log ? Math.log10(now) : now; told(); };
  let [waiting, last] = [null, 0]; // a slider asks at once, then at most ten times a second
  const tell = tried(() => { [waiting, last] = [null, performance.now()]; return change(value()); });
  input.addEventListener(main ? "input" : "change", () => {
    told();
    waiting ??= setTimeout(tell, main ? Math.max(0, last + 100 - performance.now()) : 0);
  });
  put(spec.value);
  Object.assign(input, { put, read: value, first: value(), given: JSON.stringify(spec.value) }); // for page.js
  const label = make("label", { className: kind }, spec.label, main ? beside : "", input, main ? "" : beside);
  return { name, value, label,
    set: (now) => { if (waiting === null && document.activeElement !== input) put(now); },
    tell: main ? null : (text) => {
      beside.textContent = text;
      input.ariaInvalid = Boolean(text);
      if (text) input.closest("details")?.setAttribute("open", "");
    } };
}

// a file that is dropped or chosen goes into a folder of the project, under a name that it takes
function drop(spec, input, act) {
  const send = tried(async (file) => {
    if (!file) return;
    say(`Sending ${file.name} …`);
    await act("", await ask(`/api/files/${spec.to}/${encodeURIComponent(file.name)}`, file, "PUT"));
  });
  input.addEventListener("change", () => send(input.files[0]));
  return make("label", { className: "drop", ondragover: (event) => event.preventDefault(),
    ondrop: (event) => { event.preventDefault(); send(event.dataTransfer.files[0]); } }, spec.label, input);
}

// the command and the Python lines that do the same, each copied by a click
export function sameAs(lines) {
  const blocks = Object.entries(lines).map(([name, text]) => {
    const copied = () => navigator.clipboard.writeText(text).then(() => say(`${name} copied`));
    const copy = button("Copy", copied, { ariaLabel: `Copy: ${name}` });
    return make("div", {}, make("div", { className: "buttons" }, name, copy), make("pre", {}, text));
  });
  return make("details", { className: "same" }, make("summary", {}, "Command line and Python"), ...blocks);
}
