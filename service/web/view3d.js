// Draws the ground and the routes that the page around it sends.

const EXAGGERATION = 0.25; // of the longer side: so high is the highest place drawn at most

window.addEventListener("message", ({ data, origin }) => {
  if (origin !== window.location.origin || !data.surface) return;
  const { surface: { x, y, z }, routes, dark } = data, known = z.flat().filter(value => value !== null);
  const low = Math.min(...known), high = Math.max(...known), wide = Math.abs(x.at(-1) - x[0]), deep = Math.abs(y.at(-1) - y[0]), longest = Math.max(wide, deep);
  const tall = Math.max(0.05, Math.min(EXAGGERATION, 3 * (high - low) / longest));
  const lift = (high - low) * 0.01, ink = dark ? "#e8ecef" : "#1d2329";
  const lines = routes.map(({ name, colour, path }) => ({ type: "scatter3d", mode: "lines", name, x: path.map(p => p[0]), y: path.map(p => p[1]), z: path.map(p => (p[2] ?? low) + lift), line: { color: colour, width: 8 }, hovertemplate: "%{z:.1f} m<extra>" + name + "</extra>" }));
  const axis = title => ({ title: { text: title }, color: ink, gridcolor: dark ? "#3a434c" : "#d6dbe0" });
  const view = document.getElementById("view");
  view.replaceChildren();
  window.Plotly.newPlot(view, [{ type: "surface", x, y, z, colorscale: [[0, "#9dbb94"], [0.4, "#d5d5a4"], [0.7, "#ead9b0"], [1, "#f4ead8"]], showscale: false, contours: { z: { show: true, usecolormap: false, color: "#6b6154", width: 1 } }, hovertemplate: "x %{x:.1f}, y %{y:.1f}, height %{z:.1f} m<extra></extra>" }, ...lines],
    { margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: dark ? "#1d2329" : "#ffffff", font: { color: ink }, legend: { x: 0, y: 1 }, scene: { aspectmode: "manual", aspectratio: { x: 1.6 * wide / longest, y: 1.6 * deep / longest, z: 1.6 * tall }, xaxis: axis("x [m]"), yaxis: axis("y [m]"), zaxis: axis("height [m]") } },
    { responsive: true, displaylogo: false, displayModeBar: false }).then(() => { view.dataset.drawn = "yes"; });
});
window.parent.postMessage("ready", window.location.origin);
