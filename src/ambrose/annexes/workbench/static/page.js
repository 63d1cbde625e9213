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
  Object.assign(document.getElementById("note"), { textContent: text, className: bad ? "bad" : "" });
}

export async function ask(path, body, method = body === undefined ? "GET" : "POST") {
  const content = body === undefined || body instanceof Blob ? body : JSON.stringify(body);
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

// a panel of a screen
export const titled = (title, ...children) =>
  make("section", { className: "panel" }, make("h2", {}, title), ...children);

// A panel in place of another, which keeps what a hand did there: typed, opened, scrolled, focus and caret.
// own: it was asked for there, so that a value which changed counts; else what is typed stays, and true
// says that it hides a value which changed.
export function replace(old, panel, own) {
  let hides = false;
  old.after(panel);
  panel.open = old.open;
  for (const e of panel.querySelectorAll("[name], button, a, details, summary, pre, .wide")) {
    const alike = (of) => [...of.querySelectorAll(e.name ? `[name="${CSS.escape(e.name)}"]` : e.localName)];
    const was = alike(old)[alike(panel).indexOf(e)];
    if (!was) continue;
    const changed = was.given !== e.given;
    const can = e.put && (!e.options || [...e.options].some((option) => option.value === was.value));
    if (can && was.read() !== was.first && !(own && changed)) {
      e.put(was.read());
      if (changed) [hides, e.given] = [true, was.given];
    }
    if (was.open) e.open = true;
    if (was.scrollLeft || was.scrollTop) e.scrollTo(was.scrollLeft, was.scrollTop);
    if (was !== document.activeElement) continue;
    e.focus({ preventScroll: true });
    if (was.selectionStart != null) e.setSelectionRange(was.selectionStart, was.selectionEnd);
  }
  old.remove();
  return hides;
}
