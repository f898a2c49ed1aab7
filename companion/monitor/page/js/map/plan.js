/** The reference that is flown, and what has not been sent yet: the preview of a change, and the points that are placed. */

/** The line of the reference as its leader reports it, and where the reference is now. */
export function drawReference(pen, track, leaders) {
  if (track.length > 1) pen.line(track, { colour: "quiet", width: 1.5, dash: [9, 3, 2, 3] });
  for (const { reference_enu_m: now } of leaders) {
    const [x, y] = pen.camera.project(now);
    pen.circle(now, 5 / pen.camera.scale, { colour: "text", width: 2 });
    pen.text("R", x + 11, y + 10, { size: 11, weight: 700 });
  }
}

/** `paths`: of its slots, as they are now. Paler while it is dragged, and until the vehicles have answered. `points`: those of the form, which have numbers. */
export function drawPreview(pen, preview, paths, points) {
  const alpha = preview.pending ? 0.5 : 1;
  for (const path of paths) {
    pen.line([path.from_enu_m, path.to_enu_m], { colour: "accent", width: 2, dash: [8, 5], alpha });
    const [x, y] = pen.camera.project(path.to_enu_m);
    pen.pixels([[-11, -11], [11, -11], [11, 11], [-11, 11], [-11, -11]].map(([dx, dy]) => [x + dx, y + dy]), {
      colour: "accent",
      width: 2,
    });
    pen.text(String(path.vehicle_id), x, y, { colour: "accent", size: 12, weight: 700 });
  }
  if (preview.track_enu_m.length > 1) pen.line(preview.track_enu_m, { colour: "accent", width: 3, dash: [8, 5], alpha });
  if (preview.track_enu_m.length && !points.length) drawPoint(pen, preview.track_enu_m[0], "start");
}

export function drawPoints(pen, points) {
  if (points.length > 1) pen.line(points, { colour: "accent", width: 1.5, dash: [3, 3] });
  points.forEach((point, i) => drawPoint(pen, point, String(i + 1)));
}

function drawPoint(pen, point, label) {
  const [x, y] = pen.camera.project(point);
  pen.pixels([[x - 6, y], [x + 6, y]], { colour: "accent", width: 2.5 });
  pen.pixels([[x, y - 6], [x, y + 6]], { colour: "accent", width: 2.5 });
  pen.text(label, x + 12, y - 10, { colour: "accent", size: 12, weight: 700 });
}
