// The names of curves become buttons that hide and show them. Each figure is put into a shadow root, where its
// ids and styles are its own. On paper every curve is shown.
for (const image of document.querySelectorAll("img[data-curves]")) {
  const bytes = Uint8Array.from(atob(image.src.split(",")[1]), (letter) => letter.charCodeAt(0));
  const text = new TextDecoder().decode(bytes);
  const svg = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  const set = (element, attributes) => {
    for (const name in attributes) element.setAttribute(name, attributes[name]);
    return element;
  };
  const style = document.createElement("style");
  style.textContent = `
    svg { display: block; width: 100%; height: auto; }
    [role=button] { cursor: pointer; outline: none; }
    rect { fill: transparent; }
    @media screen {
      [role=button]:hover rect { fill: #8884; }
      [role=button]:focus-visible rect { stroke: #4ba3e3; stroke-width: 1.5; }
      [aria-pressed=false] { opacity: .5; }
      .hidden { visibility: hidden; }
    }`;
  const figure = set(document.createElement("div"), {class: "curves", role: "group", "aria-label": image.alt});
  figure.attachShadow({mode: "open"}).append(style, svg);
  image.replaceWith(figure);
  JSON.parse(image.dataset.curves).forEach((name, number) => {
    const parts = (kind) => svg.querySelectorAll(`[id^="${kind}-${number}-"]`);
    const labels = parts("name");
    if (!labels.length) return;
    const [area, button] = ["rect", "g"].map((tag) => document.createElementNS(svg.namespaceURI, tag));
    labels[0].before(button);
    button.append(...labels);
    const {x, y, width, height} = button.getBBox();
    button.prepend(set(area, {x: x - 3, y: y - 2, width: width + 6, height: height + 4, rx: 2}));
    set(button, {role: "button", tabindex: 0, "aria-label": name, "aria-pressed": true});
    const toggle = () => {
      const isHidden = button.getAttribute("aria-pressed") === "true";
      button.setAttribute("aria-pressed", !isHidden);
      for (const part of parts("curve")) part.classList.toggle("hidden", isHidden);
    };
    button.addEventListener("click", toggle);
    button.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      toggle();
    });
  });
  if (!svg.querySelector("[role=button]")) continue;
  const hint = set(document.createElement("span"), {class: "hint"});
  hint.textContent = " Select a name to hide or show its curve.";
  figure.parentElement.querySelector("figcaption").append(hint);
}
