// Keys, of riders and of replays, and the timeline that some of them move.

// On the window and in the capture phase, so that they come before viser's listeners on the document.
const isTyping = (target) => target instanceof HTMLElement && (target.isContentEditable || ["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName));
const isOurButton = (target) => target instanceof HTMLButtonElement && root().contains(target);
const openDialog = () => root().querySelector("dialog[open]");

function consume(event) {
  event.preventDefault();
  event.stopImmediatePropagation();
}

function onKeyDown(event) {
  if (root() === null) return;
  if ((event.ctrlKey || event.metaKey) && event.code === "KeyK") return consume(event); // viser's palette
  if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return;
  if (isTyping(event.target) && !(event.target.id === "echelon-seek")) {
    if (event.code === "Escape") event.target.blur();
    if (event.code === "Enter" && event.target.closest("#echelon-restart")) restart();
    else if (event.code === "Enter") event.target.blur();
    return event.stopImmediatePropagation();
  }
  if (openDialog() !== null) {
    if (event.code === "KeyH" && openDialog().id === "echelon-help") openDialog().close();
    return event.stopImmediatePropagation();
  }
  // a button reached with Tab is pressed with its own keys
  if (isOurButton(event.target) && event.target.matches(":focus-visible") && ["Space", "Enter"].includes(event.code)) return event.stopImmediatePropagation();
  if (welcome === null) return;
  if (welcome.mode === "replay" && onReplayKey(event)) return consume(event);
  const action = KEYS[event.code];
  if (action !== undefined) {
    if (!amRiding()) {
      if (view !== "free" || event.code === "Space") consume(event);
      return; // in the free view viser flies its camera by these keys
    }
    consume(event);
    if (event.repeat || heldKeys.has(event.code)) return;
    heldKeys.set(event.code, action);
    return press(action);
  }
  if (event.repeat || event.shiftKey) return;
  const command = COMMANDS[event.code];
  if (command !== undefined) {
    consume(event);
    command();
  }
}

function onKeyUp(event) {
  if (!heldKeys.delete(event.code)) return;
  consume(event);
  countHeld();
  tick();
}

const COMMANDS = {
  KeyL: () => {
    if (!amRiding()) return;
    lean = !lean;
    tick();
  },
  KeyT: () => isRidden() && send({ kind: amRiding() ? "leave" : "take" }),
  KeyV: () => setView(VIEWS[(VIEWS.indexOf(view) + 1) % VIEWS.length]),
  KeyC: lookAhead,
  KeyP: () => isLive() && togglePause(),
  KeyR: () => isLive() && openRestart(),
  KeyH: () => byId("help").showModal(),
  KeyO: toggleBare,
  Escape: () => root().classList.contains("bare") && toggleBare(),
};

function onReplayKey(event) {
  if (!state) return false;
  const frames = welcome.frames;
  const by = event.shiftKey ? welcome.frame_rate || 30 : 1;
  if (event.code === "Space" || event.code === "KeyP") {
    if (!event.repeat) send({ kind: "play", playing: Boolean(state.paused) });
  } else if (event.code === "ArrowLeft") stepTo(currentFrame() - by);
  else if (event.code === "ArrowRight") stepTo(currentFrame() + by);
  else if (event.code === "Home") stepTo(0);
  else if (event.code === "End") stepTo(frames - 1);
  else return false;
  return true;
}

// while the slider runs ahead of what was last shown, steps are counted from it
const currentFrame = () => (performance.now() < seekHeldUntil ? Number(byId("seek").value) : state.frame);
let seekSentAt = 0;
let seekLater = 0;

function stepTo(frame) {
  if (!state.paused && performance.now() > seekHeldUntil) send({ kind: "play", playing: false });
  byId("seek").value = clamp(frame, 0, Math.max(0, welcome.frames - 1));
  onSeek();
}

function onSeek() {
  seekHeldUntil = performance.now() + 400;
  clearTimeout(seekLater);
  const now = performance.now();
  const go = () => {
    seekSentAt = performance.now();
    send({ kind: "seek", frame: Number(byId("seek").value) });
  };
  if (now - seekSentAt >= SEND_EVERY) go();
  else seekLater = setTimeout(go, SEND_EVERY);
}

window.addEventListener("keydown", onKeyDown, true);
window.addEventListener("keyup", onKeyUp, true);
window.addEventListener("blur", letGoOfEverything);
document.addEventListener("visibilitychange", letGoOfEverything);
window.addEventListener("pagehide", letGoOfEverything);
