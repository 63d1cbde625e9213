// Jobs: commands of the project that run beside the page, each with its log, ended within a second.
import { ask, button, choice, make, sameAs } from "/static/page.js";

export async function jobs(place, state) {
  const { kinds } = await ask("/api/jobs");
  const kind = choice("Command", kinds, () => {});
  const controller = choice("Controller", state.files.controllers, () => {});
  const record = choice("Record", state.files.records, () => {});
  const list = make("div", {});
  const panels = new Map();
  const act = (path, content) => async () => { await ask(`/api/jobs/${path}`, content()); await draw(); };
  const start = act("start", () => ({ kind: kind.list.value, controller: controller.list.value,
    record: record.list.value }));
  async function draw() {
    for (const job of (await ask("/api/jobs")).jobs.reverse()) {
      if (!panels.has(job.name)) {
        panels.set(job.name, panelOf(job, act));
        list.prepend(panels.get(job.name).panel);
      }
      panels.get(job.name).show(job);
    }
  }
  place.append(make("section", { className: "panel" }, make("h2", {}, "Start a job"),
    make("div", { className: "buttons" }, kind.label, controller.label, record.label,
      button("Start", start, { className: "main" }))), list);
  await draw();
  const timer = setInterval(() => draw().catch(() => {}), 700);
  return () => clearInterval(timer);
}

function panelOf({ name, words }, act) {
  const title = make("h2", {});
  const log = make("pre", {});
  const cancel = button("Cancel", act("cancel", () => ({ name })));
  const again = button("Again", act("start", () => ({ again: name })));
  const show = (job) => {
    const seconds = job.begun ? ` ${((job.ended || job.now) - job.begun).toFixed(0)} s` : "";
    const status = job.status === null ? "" : `, status ${job.status}`;
    title.textContent = `${name}: ${job.state}${seconds}${status}`;
    title.className = { done: "good", failed: "bad", stopped: "bad" }[job.state] || "";
    if (log.textContent !== job.log) log.textContent = job.log;
    const runs = ["waiting", "running"].includes(job.state);
    [cancel.hidden, again.hidden] = [!runs, runs];
  };
  return { show, panel: make("section", { className: "panel" }, title,
    make("div", { className: "buttons" }, cancel, again), log,
    sameAs({ "Command line": `ambrose ${words.join(" ")}` })) };
}
