// Screens that the server describes (blocks.py): words, tables, pictures, forms, pages, each drawn here.
import { ask, button, make, replace, say } from "/static/page.js";
import { form, sameAs } from "/static/controls.js";
import { chains, handle } from "/static/editor.js";
import { grid } from "/static/grid.js";

const cells = (tag, list) => make("tr", {}, ...list.map((cell) =>
  make(tag, { className: cell.mark || "" }, cell.text ?? cell)));

const DRAW = {
  words: (block) => make("p", { className: block.tone }, block.text),
  table: (block) => make("div", { className: "wide", tabIndex: 0 }, make("table", {},
    make("thead", {}, cells("th", block.columns)),
    make("tbody", {}, ...block.rows.map((row) => cells("td", row)))),
    make("p", { className: "muted" }, block.note)),
  picture: (block) => {
    const svg = new DOMParser().parseFromString(block.svg, "image/svg+xml").documentElement;
    const dots = (block.handles || []).map((spec) => handle(spec, block.step));
    return make("figure", { className: "wide", tabIndex: 0 },
      make("div", { className: dots.length ? "drawing" : "still" }, document.importNode(svg, true), ...dots),
      make("figcaption", {}, block.caption));
  },
  page: (block) => make("div", {}, make("a", { href: block.src, target: "_blank" }, "Open it alone"),
    make("iframe", { src: block.src, title: block.title, sandbox: "allow-scripts" })),
  link: (block) => make("a", { href: block.href, download: "" }, block.text),
  same: (block) => sameAs(block.lines),
  form,
  chains,
  grid,
};

export const screen = (name) => async (place) => {
  const [shown, list] = [new Map(), make("div", { className: "blocks" }, "Looking …")];
  const side = make("div", { className: "side" }); // what is turned stays in sight of its curves
  let [stamp, line, waiting, jobs, ended, left, wrong] = ["", Promise.resolve(), null, [], 0];
  place.className = ["controllers", "machine"].includes(name) ? `beside ${name}` : "";
  place.append(side, list);
  const run = async (by, to, values, quiet) => {
    try {
      const given = { stamp: shown.get(by)?.hides ? "" : stamp, width: list.clientWidth - 30 };
      show(await ask(to, { ...values, ...given }), by, quiet);
      return true;
    } catch (error) {
      for (const { body } of shown.values()) body.tell?.(error.data?.fields || {});
      say(error.message, true);
      wrong = quiet; // the next that goes well takes it away
      if (error.data?.stale)
        document.getElementById("note").append(" ", button("Reload", () => act("*", "", {})));
    }
  };
  const typed = () => Object.assign({}, ...[...shown.values()].map(({ body }) => body.values?.()));
  // by: the block that asks, "" the page itself; one after the other; of what sliders ask for, only the newest
  const act = (by, action, values, live) => {
    if (live && waiting?.action === action) { waiting.values = values; return line; }
    const mine = { values, action };
    if (live) waiting = mine;
    line = line.then(async () => {
      if (waiting === mine) waiting = null;
      if (left) return;
      const [here, quiet] = [`/api/screens/${name}`, live || !by];
      if (!action.startsWith("/")) await run(by, action ? `${here}/${action}` : here, mine.values, quiet);
      else if (await run(by, action, mine.values)) await run(by, here, typed());
    });
    return line;
  };
  function show(told, by, quiet) {
    if (!told.blocks) return;
    if (!shown.size) list.replaceChildren();
    stamp = told.stamp || stamp;
    if (told.whole) [jobs, ended] = [told.jobs, told.ended];
    for (const [key, { panel, extra, body }] of shown) {
      if (!quiet || key === by) body.tell?.({}); // also what an answer to older words told meanwhile
      if (told.blocks.some((block) => block.key === key)) continue;
      if (told.whole ? quiet && extra : !told.gone.includes(key)) continue; // what was asked for besides stays
      panel.remove();
      shown.delete(key);
    }
    told.blocks.forEach((block, i) => draw(block, by, !told.whole, shown.get(
      told.blocks.slice(0, i).findLast((other) => !other.side === !block.side)?.key)));
    if (!quiet || told.told || wrong) say(told.told);
    wrong = false;
    place.dataset.computing = told.computing; // [ms], for who measures
  }
  function draw(block, by, extra, before) {
    const text = JSON.stringify(block);
    const had = shown.get(block.key);
    const own = by === "*" || by === block.key;
    if (had?.body.take) return had.body.take(block); // it keeps what is edited
    if (had?.text === text && !(own && had.hides)) return;
    // all: what it asks for is told of every form
    const body = DRAW[block.kind](block, (action, values, live) =>
      act(block.key, action, block.all ? { ...typed(), ...values } : values, live));
    const [whole, head] = block.folded ? ["details", "summary"] : ["section", "h2"];
    const title = make(head, { className: block.tone || "" }, block.title);
    const panel = make(whole, { className: block.half ? "panel half" : "panel" }, block.title && title, body);
    const hides = had && replace(had.panel, panel, own);
    if (!had && before) before.panel.after(panel);
    else if (!had) (block.side ? side : list).prepend(panel);
    shown.set(block.key, { text, body, panel, hides, extra });
  }
  const poll = async () => {
    if (!jobs.length || list.querySelector("input:active")) return; // or what the hand holds would go
    const told = await ask("/api/jobs", { of: jobs });
    if (told.ended !== ended || told.blocks.some((block) => !shown.has(block.key))) await act("", "", typed());
    else told.blocks.forEach((block) => draw(block, ""));
  };
  await act("", "", {});
  const timer = setInterval(() => poll().catch(() => {}), 700);
  return () => { left = true; clearInterval(timer); };
};
