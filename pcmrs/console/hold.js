// Reports a button with the attribute data-hold that was pressed and held, by pointer or key, as the event "held".
// Its detail is the attribute's value at the press: a button that means something else by then is not reported.
(() => {
  const HOLD_MS = 800;
  let held = null;

  const end = () => {
    if (held === null) return;
    clearTimeout(held.timer);
    held.button.classList.remove("holding");
    held = null;
  };

  const begin = (button) => {
    if (held !== null) return;
    const detail = button.dataset.hold;
    const report = () => {
      end();
      if (button.isConnected && button.dataset.hold === detail) {
        button.dispatchEvent(new CustomEvent("held", { bubbles: true, detail }));
      }
    };
    button.classList.add("holding");
    held = { button, timer: setTimeout(report, HOLD_MS) };
  };

  const buttonOf = (event) => (event.target instanceof Element ? event.target.closest("[data-hold]") : null);
  const isPress = (event) => event.key === "Enter" || event.key === " ";

  addEventListener("pointerdown", (event) => {
    const button = buttonOf(event);
    if (button !== null && event.isPrimary && event.button === 0) begin(button);
  }, true);
  addEventListener("pointerout", (event) => {
    if (held !== null && event.target === held.button && !held.button.contains(event.relatedTarget)) end();
  }, true);
  addEventListener("keydown", (event) => {
    const button = buttonOf(event);
    if (button !== null && isPress(event) && !event.repeat) begin(button);
  }, true);
  addEventListener("keyup", (event) => { if (isPress(event)) end(); }, true);
  for (const name of ["pointerup", "pointercancel", "visibilitychange"]) addEventListener(name, end, true);
  addEventListener("blur", end);  // of the window: buttons lose the focus as they are pressed
  addEventListener("contextmenu", (event) => { if (buttonOf(event) !== null) event.preventDefault(); }, true);
})();
