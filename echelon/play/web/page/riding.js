// Riding: what hands and feet want, from keys and fingers, and when it is sent.

const KEYS = {
  KeyW: "pedal", ArrowUp: "pedal",
  KeyS: "brake", ArrowDown: "brake", Space: "brake",
  KeyA: "left", ArrowLeft: "left", KeyD: "right", ArrowRight: "right",
  KeyQ: "gear-down", KeyE: "gear-up",
};
const heldKeys = new Map(); // key code -> action
const isHeld = (action) => held.has(action);

function countHeld() {
  held.clear();
  for (const action of heldKeys.values()) held.add(action);
  for (const action of fingers.values()) held.add(action);
  for (const button of root().querySelectorAll("[data-action]")) {
    const pressed = held.has(button.dataset.action);
    button.classList.toggle("pressed", pressed);
    button.setAttribute("aria-pressed", String(pressed));
  }
}

function press(action) {
  if (action === "gear-up") send({ kind: "gear", step: 1 });
  else if (action === "gear-down") send({ kind: "gear", step: -1 });
  countHeld();
  tick();
}

function letGoOfEverything() {
  heldKeys.clear();
  fingers.clear();
  steer = 0;
  if (root() === null) return;
  countHeld();
  if (amRiding()) sendRide(performance.now());
}

function onHandlebars() {
  letGoOfEverything();
  const riding = amRiding();
  byId("pads-left").hidden = !riding;
  byId("pads-right").hidden = !riding;
  showPeople();
  if (riding && view === "free") setView("saddle");
}

function sendRide(now) {
  const ride = { kind: "ride", pedal: isHeld("pedal") ? 1 : 0, brake: isHeld("brake") ? 1 : 0, steer: Math.round(steer * 1000) / 1000, lean };
  if (!send(ride)) return;
  Object.assign(sent, ride, { at: now });
  const data = root().dataset;
  data.pedal = ride.pedal;
  data.brake = ride.brake;
  data.steer = ride.steer;
  data.lean = lean;
}

/** Moves the steering towards what is held and says so: at once when hands or feet change, else now and then. */
function tick() {
  const now = performance.now();
  const step = clamp((now - lastTick) / 1000, 0, 0.1);
  lastTick = now;
  if (!amRiding()) {
    steer = 0;
  } else {
    const wanted = (isHeld("left") ? 1 : 0) - (isHeld("right") ? 1 : 0);
    const back = wanted === 0 || wanted * steer < 0;
    const most = Math.max(step, TICK / 2000) * (back ? STEER_BACK : STEER_IN);
    const aim = wanted * steer < 0 ? 0 : wanted;
    steer += clamp(aim - steer, -most, most);
    const feet = isHeld("pedal") !== (sent.pedal > 0) || isHeld("brake") !== (sent.brake > 0) || lean !== sent.lean;
    const begun = steer !== sent.steer && (sent.steer === 0 || steer === 0);
    const moved = steer.toFixed(3) !== sent.steer.toFixed(3) && now - sent.at >= SEND_EVERY;
    if (feet || begun || moved || now - sent.at >= REPEAT_EVERY) sendRide(now);
    byId("steer-wish").style.left = `${50 - steer * 48}%`;
    byId("lean").hidden = !lean;
  }
  if (!look.sent && now - look.at >= SEND_EVERY) sendLook(now);
}
