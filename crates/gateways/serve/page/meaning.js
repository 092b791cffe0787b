// What a column or a value means, while the pointer or the focus is on its name.

const tip = document.getElementById("meaning");
let of = null;
let byFocus = false;

function hide() {
  of?.removeAttribute("aria-describedby");
  of = null;
  tip.hidden = true;
}

function show({ type, target }) {
  const named = target.closest?.("[data-meaning]") ?? null;
  if (named === of) return;
  // A row that changes below a pointer at rest tells of a pointer over it too: what the focus
  // shows stays until the focus goes.
  if (named === null && byFocus && of !== null) return;
  hide();
  if (named === null) return;
  of = named;
  byFocus = type === "focusin";
  named.setAttribute("aria-describedby", tip.id);
  tip.textContent = named.dataset.meaning;
  tip.hidden = false;
  const { left, bottom } = named.getBoundingClientRect();
  const most = document.documentElement.clientWidth - tip.offsetWidth - 8;
  tip.style.setProperty("left", `${Math.max(8, Math.min(left, most))}px`);
  tip.style.setProperty("top", `${bottom + 4}px`);
}

export function explainNames() {
  for (const event of ["pointerover", "focusin"]) document.addEventListener(event, show);
  for (const event of ["focusout", "wheel"]) document.addEventListener(event, hide, { capture: true, passive: true });
  document.addEventListener("keydown", ({ key }) => key === "Escape" && hide());
}
