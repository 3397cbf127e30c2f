// Putting it together: listeners, and what looks after the rest.

function wire() {
  const click = (id, act) => byId(id).addEventListener("click", act);
  click("take", () => send({ kind: "take" }));
  click("take-big", () => send({ kind: "take" }));
  click("leave", () => send({ kind: "leave" }));
  click("pass", () => send({ kind: "pass", to: Number(byId("pass-to").value) }));
  click("pause", togglePause);
  click("director-open", () => {
    const panel = byId("director");
    panel.hidden = !panel.hidden;
    byId("director-open").setAttribute("aria-expanded", String(!panel.hidden));
  });
  click("help-open", () => byId("help").showModal());
  click("help-close", () => byId("help").close());
  click("bare", toggleBare);
  click("bare-hint", toggleBare);
  click("restart-open", openRestart);
  click("restart-yes", restart);
  click("restart-no", () => byId("restart").close());
  click("seed-other", () => {
    byId("seed").value = Math.floor(Math.random() * 1e6);
  });
  click("save", () => send({ kind: "save" }));
  click("play", () => send({ kind: "play", playing: Boolean(state && state.paused) }));
  byId("seek").addEventListener("input", onSeek);
  byId("rate").addEventListener("change", () => {
    send({ kind: "rate", rate: Number(byId("rate").value) });
    byId("rate").blur();
  });
  byId("name").value = remember("name") || "Guest";
  byId("name").addEventListener("change", () => {
    byId("name").value = yourName();
    remember("name", yourName());
    if (viewer !== null) hello();
  });
  for (const button of root().querySelectorAll("[data-view]")) button.addEventListener("click", () => setView(button.dataset.view));
  for (const button of root().querySelectorAll("[data-slow]")) {
    button.addEventListener("click", () => send({ kind: "slow", rate: Number(button.dataset.slow) }));
  }
  for (const button of root().querySelectorAll("[data-action]")) wirePad(button);
  // a click leaves the keys to riding; whoever came by Tab stays where they are
  root().addEventListener("pointerup", (event) => {
    const control = event.target instanceof Element ? event.target.closest("button") : null;
    if (control !== null) setTimeout(() => control.blur(), 0);
  });
}

function wirePad(button) {
  button.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    button.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, button.dataset.action);
    press(button.dataset.action);
  });
  for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
    button.addEventListener(type, (event) => {
      if (!fingers.delete(event.pointerId)) return;
      countHeld();
      tick();
    });
  }
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

/** Once in a while: viser's number for this page, the connection, and what is on show for a time only. */
function lookAfter() {
  const found = findViewer();
  if (found !== null && found !== viewer) {
    viewer = found;
    if (socket === null) connect();
    else hello();
  }
  const now = performance.now();
  if (now > noticeUntil) byId("notice").hidden = true;
  if (lostAt !== null) showConnection();
  else if (now - pingSent > 2000) ping();
}

function begin() {
  const overlay = document.createElement("div");
  overlay.id = "echelon";
  overlay.dataset.connected = "false";
  overlay.innerHTML = BODY;
  document.body.append(overlay);
  const icon = document.querySelector('link[rel="icon"]');
  if (icon !== null) {
    const drawing = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="7" fill="#14191e"/><g fill="none" stroke="#f0b84a" stroke-width="3" stroke-linecap="round"><path d="M7 23 12 9M14 23 19 9M21 23 26 9"/></g></svg>';
    icon.href = `data:image/svg+xml,${encodeURIComponent(drawing)}`;
  }
  wire();
  mirror();
  if (document.createElement("canvas").getContext("webgl2") === null) notify("This browser cannot draw in 3D (WebGL 2 is missing or switched off).", Infinity);
  setInterval(tick, TICK);
  setInterval(lookAfter, 150);
}

if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", begin);
else begin();
