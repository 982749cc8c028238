// All pairs that have been matched, the worst first.

// Fill a list with a button for each map; `open` is called with the numbers of its shapes.
export function drawGallery(list, { maps, shapes }, shown, open) {
  const nameOf = (number) => shapes.find((shape) => shape.number === number)?.name ?? "";
  list.replaceChildren(
    ...maps.map((map) => {
      const item = document.createElement("li");
      const button = Object.assign(document.createElement("button"), { type: "button" });
      const verdict = document.createElement("b");
      verdict.textContent = map.verdict ?? "not judged";
      const share = map.expected_accuracy == null ? "" : ` ${Math.round(100 * map.expected_accuracy)}\u00a0%`;
      button.dataset.verdict = map.verdict ?? "";
      const error = map.mean_error == null ? "" : `, error ${(100 * map.mean_error).toFixed(1)} %`;
      button.append(`${nameOf(map.source)} → ${nameOf(map.target)} `, verdict, share, error);
      button.setAttribute("aria-current", String(map.source === shown.source && map.target === shown.target));
      button.addEventListener("click", () => open(map.source, map.target));
      item.append(button);
      return item;
    }),
  );
}
