// Lists of tables as a spreadsheet: cells that are typed in or pasted, rows that come, go and move, undo.
import { button, make, say } from "/static/page.js";
import { memory, small } from "/static/editor.js";

const STEP = { Enter: [1, 0], ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
const figures = (key, unit) => (unit || key === "elements" ? "number" : "");

export function grid(block, act) {
  let [given, sent] = [JSON.stringify(block.document), null];
  const at = {}; // the row of every list where the hand is
  const hidden = new Set(Object.values(block.columns).flat().filter((c) => !c[3]).map(([key]) => key));
  const columns = (list) => block.columns[list].filter(([key]) => !hidden.has(key));
  const place = make("div", {});
  const ask = () => act("look", { rows: now() }, true);
  const past = memory(block.document, (typed) => { (typed ? mark : show)({}); ask(); });
  const { now, edit } = past;
  const more = button("All columns", () => { hidden.clear(); more.remove(); show(); });
  const keep = () => act("rows", { rows: sent = now() }).then(() => { sent = null; });
  const element = make("div", { className: "cells", onkeydown: keys, onfocusin: enter, onpaste: paste },
    make("p", { className: "muted" }, block.hint),
    make("div", { className: "buttons" }, ...past.buttons, hidden.size ? more : null,
      button("Save", keep, { className: "main" })), place);
  const inputs = () => [...place.querySelectorAll("input")];
  // list, row and key of a cell
  const spot = (input) => input.name.split(".").map((part, i) => (i === 1 ? Number(part) : part));

  const cell = (list, r, [key, label, unit]) => {
    const input = make("input", { type: "text", name: `${list}.${r}.${key}`, className: figures(key, unit),
      defaultValue: now()[list][r][key] ?? "", ariaLabel: `${label}, ${list} ${r + 1}`, autocomplete: "off" });
    input.addEventListener("change", () => {
      input.defaultValue = input.value; // typed, so that it is no undo of the field's own any more
      edit((made) => { made[list][r][key] = input.value.trim(); }, now(), false, true);
    });
    return make("td", {}, input);
  };
  const table = (list) => {
    const rows = now()[list];
    at[list] = Math.max(Math.min(at[list] ?? Infinity, rows.length - 1), 0);
    const change = (words, text, action) => small(text, `${words} ${list} row`, () => edit((made) => {
      at[list] = action(made[list], at[list]);
    }), text !== "+" && !rows.length);
    const swap = (way) => (lines, r) => {
      lines.splice(Math.max(r + way, 0), 0, ...lines.splice(r, 1));
      return r + way;
    };
    const add = (made) => (lines, r) => { lines.splice(r + 1, 0, made(lines[r])); return r + 1; };
    const copy = (row) => ({ ...row, was: null, ...(row.name && { name: `${row.name}-copy` }) });
    const buttons = [change("Add", "+", add(() => ({ was: null }))), change("Copy", "Copy", add(copy)),
      change("Move up", "↑", swap(-1)), change("Move down", "↓", swap(1)),
      change("Delete", "✕", (lines, r) => { lines.splice(r, 1); return r; })];
    const head = make("tr", {}, make("th"), ...columns(list).map(([key, label, unit]) =>
      make("th", { className: figures(key, unit) }, label, unit && make("small", {}, ` [${unit}]`))));
    const lines = rows.map((row, r) => make("tr", { className: r === at[list] ? "at" : "" },
      make("td", { className: "muted" }, `${r + 1}`), ...columns(list).map((column) => cell(list, r, column))));
    const body = make("table", {}, make("thead", {}, head), make("tbody", {}, ...lines));
    return make("section", {}, make("div", { className: "buttons" }, make("b", {}, list), ...buttons),
      make("div", { className: "wide" }, body));
  };
  const show = () => {
    for (const key of hidden) if (Object.values(now()).flat().some((row) => row[key])) hidden.delete(key);
    const was = element.contains(document.activeElement) && document.activeElement.name;
    place.replaceChildren(...Object.keys(block.columns).map(table));
    if (was) (inputs().find((input) => input.name === was) || past.buttons[0]).focus({ preventScroll: true });
  };
  // what is wrong stands below its row
  const mark = (told) => {
    place.querySelectorAll("tr.bad").forEach((line) => line.remove());
    for (const input of inputs()) {
      const [words, line] = [told[input.name] || "", input.closest("tr")];
      input.ariaInvalid = Boolean(words);
      const said = make("td", { colSpan: line.cells.length - 1 }, make("div", {}, words));
      if (words) line.after(make("tr", { className: "bad" }, make("td"), said));
    }
  };

  function enter({ target }) {
    if (target.type !== "text") return;
    const [list, row] = spot(target);
    at[list] = row;
    for (const line of target.closest("tbody").rows) line.classList.toggle("at", line.contains(target));
    target.select();
  }
  function keys(event) {
    past.keys(event);
    const [input, way] = [event.target, STEP[event.key]];
    if (input.type === "text" && event.key === "Escape") input.value = input.defaultValue;
    if (input.type !== "text" || !way || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.shiftKey && event.key !== "Enter") return; // it selects letters
    const [from, to, end] = [input.selectionStart, input.selectionEnd, input.value.length];
    // along a text as long as there are letters
    if (way[1] && to - from < end && (way[1] < 0 ? from > 0 || to > from : to < end || to > from)) return;
    event.preventDefault();
    const [list, r, key] = spot(input);
    const along = columns(list).map(([name]) => name);
    const next = [list, r + (event.shiftKey ? -1 : 1) * way[0], along[along.indexOf(key) + way[1]]].join(".");
    const there = inputs().find((other) => other.name === next);
    if (!there) input.blur(); // what was typed counts
    (there || input).focus();
  }
  function paste(event) {
    const text = event.clipboardData.getData("text/plain").replace(/\r\n?/g, "\n").replace(/\n+$/, "");
    if (event.target.type !== "text" || !/[\t\n]/.test(text)) return;
    event.preventDefault();
    if (/\blength\b/i.test(text.split("\n")[0])) { act("stations", { table: text }).then(ask); return; }
    const [list, r, key] = spot(event.target);
    const along = columns(list).map(([name]) => name);
    const [first, lines] = [along.indexOf(key), text.split("\n").map((line) => line.split("\t"))];
    const [many, room] = [Math.max(...lines.map((line) => line.length)), along.length - first];
    if (many > room) say(`${many} columns are pasted where ${room} are left; begin further left`, true);
    else edit((made) => lines.forEach((line, i) => line.forEach((word, j) => {
      (made[list][r + i] ??= { was: null })[along[first + j]] = word.trim();
    })));
  }

  element.tell = mark;
  element.take = (told) => { // what was edited before is one undo away, what was typed since Save stays
    const [text, fresh] = [JSON.stringify(told.document), told.fresh]; // fresh: pasted, not of the file
    if (fresh || (text !== given && (!sent || sent === now()))) { past.add(told.document, sent); show(); }
    if (!fresh) given = text;
  };
  show();
  return element;
}
