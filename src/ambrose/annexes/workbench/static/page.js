// Elements, requests and words: everything of a user's stands in the page as text, never as markup.

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && name !== "list") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null)); // strings become text
  return element;
}

export function say(text, bad = false) {
  const note = document.getElementById("note");
  note.textContent = text;
  note.className = bad ? "bad" : "";
}

export async function ask(path, body, method = body === undefined ? "GET" : "POST") {
  const raw = body instanceof Blob;
  const content = body === undefined || raw ? body : JSON.stringify(body);
  const answer = await fetch(path, { method, body: content });
  const text = await answer.text();
  let data = {};
  try { data = JSON.parse(text); } catch { data = { error: text }; }
  if (!answer.ok) throw Object.assign(new Error(data.error || `status ${answer.status}`), { data });
  return data;
}

// a handler whose refusals are shown in words
export const tried = (action) => async (...given) => {
  try { await action(...given); } catch (error) { say(error.message, true); }
};

export const button = (text, action, properties = {}) =>
  make("button", { type: "button", onclick: tried(action), ...properties }, text);

export function choice(text, options, action, chosen) {
  const list = make("select", {}, ...options.map((name) => make("option", { value: name }, name)));
  if (chosen !== undefined) list.value = chosen;
  list.addEventListener("change", tried(() => action(list.value)));
  return { list, label: make("label", { className: "row" }, text, list) };
}

// told(value) gives the words beside the slider; action gets at most ten values a second
export function slider(text, [low, high, step], value, told, action) {
  const shown = make("output", {}, told(value));
  const input = make("input", { type: "range", min: low, max: high, step, value });
  let waiting = null;
  const send = () => { waiting = null; tried(action)(Number(input.value)); };
  input.addEventListener("input", () => {
    shown.textContent = told(Number(input.value));
    waiting ??= setTimeout(send, 100);
  });
  const set = (now) => {
    if (waiting !== null || document.activeElement === input) return;
    input.value = now;
    shown.textContent = told(now);
  };
  return { input, set, label: make("label", {}, text, shown, input) };
}

// the command and the Python lines that do the same, each copied by a click
export function sameAs(lines) {
  const blocks = Object.entries(lines).map(([name, text]) => {
    const copy = button("Copy", async () => {
      await navigator.clipboard.writeText(text);
      say(`${name} copied`);
    }, { ariaLabel: `Copy: ${name}` });
    return make("div", {}, make("div", { className: "buttons" }, name, copy), make("pre", {}, text));
  });
  return make("details", { className: "same" }, make("summary", {}, "The same without this page"),
    ...blocks);
}
