// A button in each heading of a sortable table sorts its rows. Numbers come before text, in whose order
// digits count as numbers; cells without a key come last in both directions, and a column of such cells has no
// button.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const kind = (key) => (!key ? 2 : Number.isNaN(Number(key)) ? 1 : 0);
  heads.forEach((head, column) => {
    const keyOf = (row) => row.cells[column].dataset.sort;
    if (![...body.rows].some(keyOf)) return;
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      const compare = (a, b) => {
        const [x, y] = [a, b].map(keyOf);
        const apart = kind(x) - kind(y);
        if (!x || !y) return apart;
        return sign * (apart || (kind(x) ? x.localeCompare(y, "en", {numeric: true}) : x - y));
      };
      body.append(...[...body.rows].sort(compare));
    });
  });
}
