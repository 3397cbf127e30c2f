// Directing: pause, restart, and the picture alone.

function togglePause() {
  if (!mayDirect()) return notify(`${rider().name} holds the handlebars and directs.`, 2500);
  send({ kind: "pause", paused: !(state && state.paused) });
}

function openRestart() {
  if (!mayDirect()) return notify(`${rider().name} holds the handlebars and directs.`, 2500);
  letGoOfEverything();
  byId("seed").value = welcome.seed;
  byId("number").value = welcome.agents;
  byId("restart").showModal();
  byId("restart-yes").focus();
}

function restart() {
  const whole = (id, low, high) => {
    const value = Number.parseInt(byId(id).value, 10);
    return Number.isInteger(value) && value >= low && value <= high ? value : null;
  };
  send({ kind: "restart", seed: whole("seed", 0, 2147483647), agents: whole("number", 1, 100000) });
  byId("restart").close();
}

function toggleBare() {
  const bare = root().classList.toggle("bare");
  byId("bare-hint").hidden = !bare;
}
