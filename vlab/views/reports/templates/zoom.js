// A click enlarges a figure; wheel and drag move through it; Escape or a second click closes it.
(() => {
  let box = null, start = null, moved = false;
  const open = () => document.querySelector(".zoomed");
  const close = () => {
    const figure = open();
    if (!figure) return;
    figure.querySelector("svg").setAttribute("viewBox", figure.dataset.view);
    figure.classList.remove("zoomed");
  };
  const show = (svg) => svg.setAttribute("viewBox", box.join(" "));
  document.querySelectorAll("figure").forEach((figure) => {
    const svg = figure.querySelector("svg");
    if (!svg || !svg.getAttribute("viewBox")) return;
    figure.classList.add("zoomable");
    figure.addEventListener("click", () => {
      if (moved) { moved = false; return; }
      if (figure === open()) { close(); return; }
      close();
      figure.dataset.view = svg.getAttribute("viewBox");
      box = figure.dataset.view.split(/[ ,]+/).map(Number);
      figure.classList.add("zoomed");
    });
    figure.addEventListener("wheel", (event) => {
      if (figure !== open()) return;
      event.preventDefault();
      const at = svg.getBoundingClientRect(), factor = Math.exp(event.deltaY / 500);
      const x = box[0] + box[2] * (event.clientX - at.left) / at.width;
      const y = box[1] + box[3] * (event.clientY - at.top) / at.height;
      box = [x - (x - box[0]) * factor, y - (y - box[1]) * factor, box[2] * factor, box[3] * factor];
      show(svg);
    }, { passive: false });
    figure.addEventListener("pointerdown", (event) => { if (figure === open()) start = [event.clientX, event.clientY, ...box]; });
    figure.addEventListener("pointermove", (event) => {
      if (!start) return;
      const at = svg.getBoundingClientRect(), dx = event.clientX - start[0], dy = event.clientY - start[1];
      if (Math.abs(dx) + Math.abs(dy) > 4) moved = true;
      box = [start[2] - dx * box[2] / at.width, start[3] - dy * box[3] / at.height, box[2], box[3]];
      show(svg);
    });
    figure.addEventListener("pointerup", () => { start = null; });
  });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") close(); });
})();
