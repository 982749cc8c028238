// What the source has is carried to other shapes along the maps, and maps are measured by a truth.
import { ask, download } from "esd/server.js";

const element = (id) => document.getElementById(id);

// `now` returns the shapes that are shown and all maps; `guarded` shows why an action failed.
export function connectTransfer(now, guarded) {
  // Let the user choose a file, and send it.
  function load(address) {
    const input = element("data-file");
    input.onchange = guarded(async () => {
      const [file] = input.files;
      input.value = "";
      if (file) await ask(`${address}?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    });
    input.click();
  }

  const pairOf = ({ source, target }) => `maps/${source.number}/${target.number}`;
  const carry = ({ source, target }) => ask(`maps/${source}/${target}/carry`, { method: "POST" });

  const listen = (id, action) => element(id).addEventListener("click", action);
  listen("load-labels", () => load(`shapes/${now().source.number}/labels`));
  listen("store-labels", () => download(`shapes/${now().target.number}/labels`));
  listen("load-truth", () => load(`${pairOf(now())}/truth`));
  for (const side of ["source", "target"]) listen(`points-${side}`, () => load(`shapes/${now()[side].number}/points`));
  listen("carry-data", guarded(() => carry({ source: now().source.number, target: now().target.number })));
  listen("carry-all", guarded(async () => {
    const { source, maps } = now();
    const along = maps.filter((map) => map.source === source?.number);
    if (!along.length) throw new Error("No shape has been matched from this source.");
    for (const map of along) await carry(map);
  }));
  listen("export-look", () => download(`${pairOf(now())}/look`));

  // After each change of the state.
  return () => {
    const { source, target, map } = now();
    element("transfer").hidden = !source || !target;
    element("store-labels").disabled = !target?.labels;
    element("carry-data").disabled = element("load-truth").disabled = !map;
    element("export-look").hidden = !source?.look;
    const known = [source, target].filter((shape) => shape?.points).map(({ name }) => name);
    element("truth-state").textContent = map?.mean_error != null
      ? `Mean error ${(100 * map.mean_error).toFixed(1)} % of √area`
      : known.length ? `Points known: ${known.join(", ")}` : "";
  };
}
