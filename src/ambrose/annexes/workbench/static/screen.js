// Screens that the server describes (blocks.py): words, tables, pictures, forms, pages, each drawn here.
import { ask, button, make, say } from "/static/page.js";
import { form, sameAs } from "/static/controls.js";

const cells = (tag, list) => make("tr", {}, ...list.map((cell) =>
  make(tag, { className: cell.mark || "" }, cell.text ?? cell)));

const DRAW = {
  words: (block) => make("p", { className: block.tone }, block.text),
  table: (block) => make("div", { className: "wide" }, make("table", {},
    make("thead", {}, cells("th", block.columns)),
    make("tbody", {}, ...block.rows.map((row) => cells("td", row)))),
    make("p", { className: "muted" }, block.note)),
  picture: (block) => {
    const svg = new DOMParser().parseFromString(block.svg, "image/svg+xml").documentElement;
    return make("figure", { className: "wide" }, document.importNode(svg, true),
      make("figcaption", {}, block.caption));
  },
  page: (block) => make("div", {}, make("a", { href: block.src, target: "_blank" }, "Open it alone"),
    make("iframe", { src: block.src, title: block.title, sandbox: "allow-scripts" })),
  link: (block) => make("a", { href: block.href, download: "" }, block.text),
  same: (block) => sameAs(block.lines),
  form,
};

export const screen = (name) => async (place) => {
  const [shown, list] = [new Map(), make("div", { className: "blocks" }, "Looking …")];
  let [stamp, line, waiting, jobs, ended, left] = ["", Promise.resolve(), null, [], 0, false];
  place.append(list);
  const run = async (to, values) => {
    try {
      show(await ask(to, { ...values, stamp, width: list.clientWidth - 30 }));
      return true;
    } catch (error) {
      for (const { body } of shown.values()) body.tell?.(error.data?.fields || {});
      say(error.message, true);
      if (error.data?.stale) document.getElementById("note").append(" ", button("Reload", () => act("", {})));
    }
  };
  // one after the other; of what sliders ask for, only the newest
  const act = (action, values, live) => {
    if (live && waiting) { waiting.values = values; return line; }
    const mine = { values };
    if (live) waiting = mine;
    line = line.then(async () => {
      if (waiting === mine) waiting = null;
      if (left) return;
      const here = `/api/screens/${name}`;
      if (!action.startsWith("/")) await run(action ? `${here}/${action}` : here, mine.values);
      else if (await run(action, mine.values)) await run(here, {});
    });
    return line;
  };
  function show(told) {
    if (!told.blocks) return;
    if (!shown.size) list.replaceChildren();
    stamp = told.stamp || stamp;
    if (told.whole) [jobs, ended] = [told.jobs, told.ended];
    for (const [key, { panel }] of shown) {
      if (told.whole ? told.blocks.some((block) => block.key === key) : !told.gone.includes(key)) continue;
      panel.remove();
      shown.delete(key);
    }
    told.blocks.forEach((block, i) => draw(block, shown.get(told.blocks[i - 1]?.key)));
    say(told.told);
    place.dataset.computing = told.computing; // [ms], for who measures
  }
  function draw(block, before) {
    const text = JSON.stringify(block);
    const had = shown.get(block.key);
    had?.body.tell?.({});
    if (had?.text === text) return;
    const body = DRAW[block.kind](block, act);
    const [whole, head] = block.folded ? ["details", "summary"] : ["section", "h2"];
    const title = make(head, { className: block.tone || "" }, block.title);
    const panel = make(whole, { className: block.half ? "panel half" : "panel" }, block.title && title, body);
    panel.open = had?.panel.open;
    const held = had && [...had.panel.querySelectorAll("button")].indexOf(document.activeElement);
    if (had) had.panel.replaceWith(panel);
    else if (before) before.panel.after(panel);
    else list.prepend(panel);
    if (held >= 0) panel.querySelectorAll("button")[held]?.focus();
    shown.set(block.key, { text, body, panel });
  }
  const poll = async () => {
    if (!jobs.length) return;
    const told = await ask("/api/jobs", { of: jobs });
    if (told.ended !== ended || told.blocks.some((block) => !shown.has(block.key))) await act("", {});
    else told.blocks.forEach((block) => draw(block));
  };
  await act("", {});
  const timer = setInterval(() => poll().catch(() => {}), 700);
  return () => { left = true; clearInterval(timer); };
};
