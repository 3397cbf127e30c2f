// Looking: from where, and by dragging the picture.

const VIEWS = ["saddle", "follow", "free"];

function setView(wanted) {
  view = wanted;
  send({ kind: "view", view });
  if (view === "saddle") look.sent = false;
  for (const name of VIEWS) byId(`view-${name}`).setAttribute("aria-pressed", String(name === view));
  mirror();
}

function sendLook(now) {
  look.sent = send({ kind: "look", yaw: look.yaw, pitch: look.pitch });
  look.at = now;
}

function lookAhead() {
  look.yaw = look.pitch = 0;
  look.sent = false;
}

let drag = null; // of the picture: pointer, place, and how far it came
let lastTap = 0;
const isPicture = (event) => event.target instanceof HTMLCanvasElement && !root().contains(event.target);

function onPicturePointer(event) {
  if (root() === null || view !== "saddle") return;
  if (event.type === "pointerdown" && isPicture(event) && drag === null) {
    drag = { id: event.pointerId, x: event.clientX, y: event.clientY, way: 0 };
    event.target.setPointerCapture(event.pointerId);
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  } else if (drag !== null && event.pointerId === drag.id) {
    if (event.type === "pointermove") {
      const dx = event.clientX - drag.x;
      const dy = event.clientY - drag.y;
      drag.way += Math.abs(dx) + Math.abs(dy);
      drag.x = event.clientX;
      drag.y = event.clientY;
      // the picture is what is dragged: to the right, and we look to the left
      const turned = look.yaw + dx * LOOK_PER_PIXEL;
      look.yaw = clamp(Math.atan2(Math.sin(turned), Math.cos(turned)), -3.14159, 3.14159);
      look.pitch = clamp(look.pitch + dy * LOOK_PER_PIXEL, -1.5, 1.5);
      look.sent = false;
    } else if (event.type !== "pointerdown") {
      const now = performance.now();
      if (drag.way < 6 && event.type === "pointerup") {
        if (now - lastTap < 350) lookAhead();
        lastTap = now;
      }
      drag = null;
    }
  } else if (!isPicture(event)) {
    return;
  }
  event.stopImmediatePropagation();
  if (event.cancelable && event.type === "wheel") event.preventDefault();
}

for (const type of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) window.addEventListener(type, onPicturePointer, true);
for (const type of ["wheel", "contextmenu", "dblclick"]) {
  window.addEventListener(type, (event) => {
    if (root() === null || view !== "saddle" || !isPicture(event)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
  }, { capture: true, passive: false });
}
