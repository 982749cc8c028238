// Colours of values, and how values are distributed.

// Red, green and blue from 0 to 1 of a share from 0 to 1, between the stops of a ramp.
export function ramp(stops, share) {
  const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const low = Math.min(Math.floor(at), stops.length - 2);
  return [0, 1, 2].map((k) => stops[low][k] + (at - low) * (stops[low + 1][k] - stops[low][k]));
}

// A colour of a number, unlike those of the numbers near it: hues a golden angle apart.
export function distinct(number) {
  const hue = (number * 137.508) % 360;
  const light = [0.62, 0.48, 0.76][number % 3];
  const spread = 0.6 * Math.min(light, 1 - light);
  return [0, 8, 4].map((k) => {
    const turn = (k + hue / 30) % 12;
    return light - spread * Math.max(-1, Math.min(turn - 3, 9 - turn, 1));
  });
}

export const css = (colour) => `rgb(${colour.map((x) => Math.round(255 * x)).join()})`;

// Counts of the known values in equal bins; those beyond the ends count at the ends.
export function histogram(values, low, high, bins) {
  const counts = new Array(bins).fill(0);
  for (const value of values) {
    if (Number.isNaN(value)) continue;
    const bin = Math.floor(((value - low) / (high - low || 1)) * bins);
    counts[Math.min(Math.max(bin, 0), bins - 1)]++;
  }
  return counts;
}

// The values below which these shares of the known ones lie.
export function quantiles(values, shares) {
  const known = Float32Array.from(values.filter((value) => !Number.isNaN(value))).sort();
  return shares.map((share) => known[Math.round(share * (known.length - 1))] ?? 0);
}
