// The screens in the order of the work; the address after # says which one is open.
import { ask, button, make, say } from "/static/page.js";
import { jobs } from "/static/jobs.js";
import { live } from "/static/live.js";

const SCREENS = { live: ["Live rig", live], jobs: ["Jobs", jobs] };

let leave = null;

async function open() {
  const wanted = location.hash.slice(1);
  const name = SCREENS[wanted] ? wanted : Object.keys(SCREENS)[0];
  const [title, screen] = SCREENS[name];
  if (leave) leave();
  leave = null;
  say("");
  document.title = `${title} – Ambrose`;
  document.getElementById("screens").replaceChildren(...Object.entries(SCREENS).map(([key, [text]]) => {
      const link = make("a", { href: `#${key}` }, text);
      if (key === name) link.setAttribute("aria-current", "page");
      return link;
    }));
  const place = document.getElementById("screen");
  try {
    const state = await ask("/api/state");
    document.getElementById("project").textContent = state.folder;
    place.replaceChildren();
    if (state.machine) leave = await screen(place, state);
    else beginning(place, state);
  } catch (error) { say(error.message, true); }
}

function beginning(place, state) {
  const list = make("select", {}, ...state.bundled.map((name) => make("option", {}, name)));
  list.value = "seal-rig";
  const start = async () => { await ask("/api/machine/begin", { machine: list.value }); open(); };
  place.replaceChildren(make("section", { className: "panel" },
    make("h2", {}, "This folder has no machine yet"),
    make("p", {}, "Put your machine file into it as machine.toml, or begin with a bundled machine:"),
    make("div", { className: "buttons" }, list,
      button("Begin", start, { className: "main" }))));
}

history.replaceState(null, "", location.pathname + location.hash); // the token is used up
window.addEventListener("hashchange", open);
open();
