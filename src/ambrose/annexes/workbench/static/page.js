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
