// The screens in the order of the work; the address after # says which one is open.
import { ask, make, say } from "/static/page.js";
import { live } from "/static/live.js";
import { screen } from "/static/screen.js";

const BESIDE = ["studies", "jobs"]; // no steps of the chain
const OWN = { live }; // all others are described by the server
let leave = null;

async function open() {
  leave?.();
  leave = null;
  say("");
  const place = document.getElementById("screen");
  try {
    const state = await ask("/api/state");
    const titles = Object.fromEntries(state.screens);
    const wanted = location.hash.slice(1) || "live";
    const name = state.machine && titles[wanted] ? wanted : "machine";
    document.title = `${titles[name]} – Ambrose`;
    document.getElementById("project").textContent = state.folder;
    document.getElementById("screens").replaceChildren(...state.screens.map(([key, text]) =>
      make("a", { href: `#${key}`, ...(key === name ? { ariaCurrent: "page" } : {}) }, text)));
    const mine = make("div", {});
    const chain = state.screens.filter(([key]) => !BESIDE.includes(key)); // in the order of the work
    const step = chain.findIndex(([key]) => key === name);
    const [next, text] = chain[step + 1] || [];
    const where = step < 0 ? "" : `Step ${step + 1} of ${chain.length}: ${chain[step][1]}. `;
    place.replaceChildren(make("p", { className: "muted" }, where,
      ...(step >= 0 && next ? ["Next: ", make("a", { href: `#${next}` }, text)] : [])), mine);
    leave = await (OWN[name] || screen(name))(mine, state);
  } catch (error) { say(error.message, true); }
}

history.replaceState(null, "", location.pathname + location.hash); // the token is used up
window.addEventListener("hashchange", open);
open();
