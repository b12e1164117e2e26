// Presses of buttons with the attribute data-meaning. A click, or the event "held" of a button with data-hold that was
// pressed and held, is reported with the meaning at the press: what the button means at the release was never pressed.
// The report also has the newest beat of the server, which shows how old the report is when it arrives.
(() => {
  const HOLD_MS = 800;
  let held = null;
  let press = null;
  let beat = "";

  const isConnected = () => window.socket?.connected === true;

  const end = () => {
    if (held === null) return;
    clearTimeout(held.timer);
    held.button.classList.remove("holding");
    held = null;
  };

  const isUnder = (button, x, y) => button.contains(document.elementFromPoint(x, y));

  const begin = (button, point) => {
    if (held !== null) return;
    const noted = press;
    const report = () => {
      const isOver = held.point === null || isUnder(button, ...held.point);
      end();
      if (isOver && button.isConnected && button.dataset.meaning === noted.meaning && isConnected()) {
        noted.reported = true;
        button.dispatchEvent(new CustomEvent("held", { bubbles: true, detail: { meaning: noted.meaning, beat } }));
      }
    };
    button.classList.add("holding");
    held = { button, point, timer: setTimeout(report, HOLD_MS) };
  };

  const inside = (event, selector) => (event.target instanceof Element ? event.target.closest(selector) : null);
  const isPress = (event) => event.key === "Enter" || event.key === " ";
  const meaningIn = (around) => around.querySelector("[data-meaning]")?.dataset.meaning ?? "";

  const note = (event, point) => {
    const around = inside(event, ".asking");
    press = around === null ? null : { around, meaning: meaningIn(around), reported: false };
    const button = inside(event, "[data-hold]");
    if (press !== null && button !== null) begin(button, point);
  };

  window.pcmrsPresses = {
    beat: (newest) => { beat = newest; },
    // Returns what a click on `around` reports; null for nothing: it ends a hold, or the server cannot be reached.
    click: (event, around) => {
      const noted = press;
      press = null;
      if (!isConnected()) return null;
      if (noted === null || noted.around !== around) {
        const byAssistiveTechnology = noted === null && event.detail === 0;
        return byAssistiveTechnology ? { meaning: meaningIn(around), beat } : null;
      }
      return noted.reported ? null : { meaning: noted.meaning, beat };
    },
  };

  addEventListener("pointerdown", (event) => {
    if (event.isPrimary && event.button === 0) note(event, [event.clientX, event.clientY]);
  }, true);
  addEventListener("pointermove", (event) => {
    if (held === null || held.point === null || !event.isPrimary) return;
    held.point = [event.clientX, event.clientY];
    if (!isUnder(held.button, ...held.point)) end();
  }, true);
  addEventListener("pointerout", (event) => {
    if (held !== null && held.button.contains(event.target) && !held.button.contains(event.relatedTarget)) end();
  }, true);
  addEventListener("keydown", (event) => { if (isPress(event) && !event.repeat) note(event, null); }, true);
  addEventListener("keyup", (event) => { if (isPress(event)) end(); }, true);
  for (const name of ["pointerup", "pointercancel", "visibilitychange"]) addEventListener(name, end, true);
  addEventListener("blur", end);  // of the window: buttons lose the focus as they are pressed
  addEventListener("contextmenu", (event) => { if (inside(event, "[data-hold]") !== null) event.preventDefault(); }, true);
})();
