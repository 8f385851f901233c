// A map of the operator's choice between the ground and its energy: pictures in Web Mercator, turned to the coordinates of this map.

import { make } from "./dom.js";
import { latLon, map, world } from "./map.js";
import { now, on } from "./state.js";

const PIXELS = 256, DEEPEST = 19;

/** Where a latitude and longitude is on the square of Web Mercator, 0 to 1. */
const mercator = ([lat, lon]) => [lon / 360 + 0.5, 0.5 - Math.asinh(Math.tan(lat * Math.PI / 180)) / (2 * Math.PI)];

const load = address => new Promise((done, fail) => Object.assign(new Image(), { onload() { done(this); }, onerror: fail, referrerPolicy: "origin", src: address })); // some hosts want to know who asks

const Turned = L.GridLayer.extend({
  createTile(at, done) {
    const canvas = make("canvas", { width: PIXELS, height: PIXELS }), pen = canvas.getContext("2d"), corner = (right, down) => mercator(latLon(world(map.unproject(L.point(at.x + right, at.y + down).multiplyBy(PIXELS), at.z))));
    const corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(place => corner(...place)), [[x, y], [ex, ey], [sx, sy]] = corners;
    const zoom = Math.min(DEEPEST, Math.max(0, Math.round(-Math.log2(Math.hypot(ex - x, ey - y))))), count = 2 ** zoom, scale = count / PIXELS;
    pen.setTransform(new DOMMatrix([(ex - x) * scale, (ey - y) * scale, (sx - x) * scale, (sy - y) * scale, x * count, y * count]).inverse()); // a picture is 1 wide
    const [[west, east], [north, south]] = [0, 1].map(axis => corners.map(one => one[axis] * count)).map(all => [Math.floor(Math.min(...all)), Math.floor(Math.max(...all))]), pictures = [];
    for (let col = west; col <= east; col += 1) for (let row = Math.max(north, 0); row <= Math.min(south, count - 1); row += 1) {
      const address = L.Util.template(this.options.url, { z: zoom, x: (col + count) % count, y: row });
      pictures.push(load(address).then(picture => pen.drawImage(picture, col, row, 1.002, 1.002))); // else a line is seen between two
    }
    Promise.allSettled(pictures).then(() => done(null, canvas));
    return canvas;
  },
});

/** Offers the map that the operator set, wherever it is known where on Earth the ground is. */
export function use({ url, attribution }) {
  const pane = map.createPane("basemap"), layer = new Turned({ url, attribution, pane: "basemap", minZoom: map.getMinZoom() }), choice = L.control.layers(null, { "Base map": layer }, { collapsed: false });
  pane.style.zIndex = 205;
  L.control.attribution({ prefix: false, position: "bottomleft" }).addTo(map);
  layer.on("add remove", () => map.getContainer().classList.toggle("based", map.hasLayer(layer)));
  on("layers", () => {
    choice.remove();
    if (!now.layers?.lat_lon) { layer.remove(); return; }
    choice.addTo(map);
    if (map.hasLayer(layer)) layer.redraw();
  });
}
