/** What does not move: grid, fence, obstacles, homes; and the scale bar and north. */

const GRID_PX = 70; // at least, between two lines
const LOW_PX = 320; // a map on a phone
const LARGEST_Z = 500; // an obstacle without an upper end is drawn up to the fence

export function drawGrid(pen) {
  const { camera } = pen;
  const step = niceStep(GRID_PX / camera.scale);
  const corners = [[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]];
  const onGround = corners.map(([x, y]) => camera.unproject(x, y, 0));
  const bounds = [0, 1].map((i) => [Math.min(...onGround.map((p) => p[i])), Math.max(...onGround.map((p) => p[i]))]);
  const [[x0, x1], [y0, y1]] = bounds.map(([low, high]) => [Math.floor(low / step) * step, Math.ceil(high / step) * step]);
  if ((x1 - x0) / step > 200 || (y1 - y0) / step > 200) return; // nearly level view: no more than a haze
  for (let x = x0; x <= x1; x += step) pen.line([[x, y0, 0], [x, y1, 0]], { colour: "grid" });
  for (let y = y0; y <= y1; y += step) pen.line([[x0, y, 0], [x1, y, 0]], { colour: "grid" });
}

/** The zero of the fleet frame: x to the east, y to the north. */
export function drawOrigin(pen) {
  const reach = 12 / pen.camera.scale;
  pen.line([[-reach, 0, 0], [reach, 0, 0]], { colour: "quiet", width: 1.5 });
  pen.line([[0, -reach, 0], [0, reach, 0]], { colour: "quiet", width: 1.5 });
  const [x, y] = pen.camera.project([0, 0, 0]);
  pen.text("0", x + 9, y + 9, { colour: "quiet", size: 10 });
}

export function drawFence(pen, file) {
  const outline = file.fence_outline_enu_m;
  if (outline.length < 3) return;
  const at = (z) => outline.map(([x, y]) => [x, y, z]);
  const style = { colour: "fence", width: 2, dash: [10, 4] };
  pen.polygon(at(Math.max(0, file.fence_floor_m)), style);
  if (!pen.camera.is3d) return;
  pen.polygon(at(file.fence_ceiling_m), { ...style, width: 1, alpha: 0.6 });
  for (const [x, y] of outline) {
    pen.line([[x, y, Math.max(0, file.fence_floor_m)], [x, y, file.fence_ceiling_m]], { ...style, width: 1, alpha: 0.6 });
  }
}

export function drawObstacles(pen, file) {
  for (const obstacle of file.obstacles) {
    const floor = Math.max(0, obstacle.floor_m);
    const top = Math.min(obstacle.top_m, Math.max(file.fence_ceiling_m, floor), LARGEST_Z);
    const at = (z) => obstacle.outline_enu_m.map(([x, y]) => [x, y, z]);
    const style = { colour: "obstacle", width: 1.5, fill: "obstacle", fillAlpha: 0.28 };
    pen.polygon(at(floor), style);
    if (!pen.camera.is3d) continue;
    const [low, high] = [at(floor), at(top)];
    low.forEach((corner, i) => {
      const next = (i + 1) % low.length;
      pen.polygon([corner, low[next], high[next], high[i]], { fill: "obstacle", fillAlpha: 0.1 });
    });
    pen.polygon(high, style);
  }
}

export function drawHomes(pen, file, shownIds) {
  for (const [id, position] of Object.entries(file.homes_enu_m)) {
    if (!shownIds.has(Number(id))) continue;
    const [x, y] = pen.camera.project(position);
    pen.pixels([[x - 7, y], [x, y - 7], [x + 7, y], [x + 5, y], [x + 5, y + 7], [x - 5, y + 7], [x - 5, y], [x - 7, y]], {
      colour: "quiet",
      width: 1.2,
    });
    pen.text(id, x, y + 2, { colour: "quiet", size: 10 });
  }
}

export function drawScaleBar(pen) {
  const { camera } = pen;
  const lengthM = niceStep(80 / camera.scale);
  const [left, bottom, length] = [14, camera.height - 16, lengthM * camera.scale];
  const ticks = [[left, bottom - 5], [left, bottom], [left + length, bottom], [left + length, bottom - 5]];
  pen.pixels(ticks, { colour: "map", width: 5 });
  pen.pixels(ticks, { colour: "text", width: 2 });
  pen.text(`${lengthM >= 1000 ? `${lengthM / 1000} km` : `${lengthM} m`}`, left + length / 2, bottom - 12, { size: 12 });
}

export function drawNorth(pen) {
  const { camera } = pen;
  const beside = camera.height < LOW_PX; // the buttons, which fill its right edge
  const [x, y] = [camera.width - (beside ? 86 : 30), camera.height - 34];
  const [dx, dy] = [-Math.sin(camera.azimuth), -Math.cos(camera.azimuth) * Math.max(0.25, Math.cos(camera.tilt))];
  const tip = [x + 16 * dx, y + 16 * dy];
  const side = [-dy * 5, dx * 5];
  const outline = [tip, [x - 12 * dx + side[0], y - 12 * dy + side[1]], [x - 7 * dx, y - 7 * dy]];
  pen.pixels([...outline, [x - 12 * dx - side[0], y - 12 * dy - side[1]], tip], { colour: "text", width: 1.5 });
  pen.text("N", x + 25 * dx, y + 25 * dy, { size: 12, weight: 600 });
}

/** 1, 2 or 5 times a power of ten, not smaller than `least`. */
export function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => rounded(factor * power)).find((step) => step >= least) ?? 10 * power;
}

function rounded(value) {
  return Number(value.toPrecision(3));
}
