/** Plots over time: separation, error to slot, altitude, lateness of the ticks. */

import uPlot from "../../vendor/uplot/uPlot.esm.js";
import { clock, number } from "../format.js";
import { columns, seriesFor } from "./plot_series.js";
import { html, render } from "./lit.js";

const PLOTS = [
  { key: "nearestM", title: "Distance to the nearest", unit: "m", digits: 2, separation: true },
  { key: "errorM", title: "Error to slot", unit: "m", digits: 2 },
  { key: "altitudeM", title: "Altitude", unit: "m", digits: 1 },
  { key: "lateMs", title: "Tick lateness, p99", unit: "ms", digits: 1 },
];
const SPANS_S = { 60: "1 min", 180: "3 min", 600: "10 min" };
const TICKS_S = { 60: 30, 180: 60, 600: 180 }; // two or three labels, which fit beside each other
const COMMANDS = new Set(["command"]);

export class Plots {
  constructor(element, store) {
    this._element = element;
    this._store = store;
    this._spanS = 180;
    this._charts = [];
    this._key = "";
    this._shownS = null;
    new ResizeObserver(() => this._fit()).observe(element);
  }

  /** Draws where there is something new; rebuilds the charts where other lines or colours are needed. */
  update(colours, theme) {
    if (!this._element.clientWidth) return;
    const lines = seriesFor(this._store, colours);
    const key = `${theme} ${this._spanS} ${JSON.stringify(lines)}`;
    const newest = this._store.history.points.at(-1)?.timeS ?? null;
    if (key === this._key && newest === this._shownS) return;
    if (key !== this._key) this._build(lines, colours);
    this._key = key;
    this._shownS = newest;
    const points = this._store.history.points.filter(({ timeS }) => timeS >= newest - this._spanS);
    this._commands = this._store.events.filter((event) => COMMANDS.has(event.kind)).map((event) => event.time_s);
    this._charts.forEach((chart, i) => {
      chart.setData(columns(points, PLOTS[i], lines, this._store.file));
    });
  }

  _build(lines, colours) {
    this._charts.forEach((chart) => chart.destroy());
    render(this._frame(lines), this._element);
    this._charts = [...this._element.querySelectorAll(".plot")].map((element, i) => this._chart(element, PLOTS[i], lines, colours));
    this._fit();
  }

  _frame(lines) {
    const choose = (event) => {
      this._spanS = Number(event.target.value);
      this._key = "";
    };
    return html`<div class="heading"><h2>Plots</h2>
        <ul class="plot-key">${lines.map((line) => html`<li>
          <svg viewBox="0 0 22 8" width="22" height="8" aria-hidden="true"><line x1="0" y1="4" x2="22" y2="4" stroke=${line.stroke}
            stroke-width=${line.width} stroke-dasharray=${line.dash.join(" ")}></line></svg>${line.label}</li>`)}
          <li><span class="marker" aria-hidden="true">┊</span>command</li></ul>
        <label class="quiet">Last <select @change=${choose}>${Object.entries(SPANS_S).map(([value, text]) => html`
          <option value=${value} .selected=${Number(value) === this._spanS}>${text}</option>`)}</select></label></div>
      <div class="plot-row" role="group" aria-label="Plots over time" tabindex="0">${PLOTS.map(({ title, unit }) => html`<figure class="plot">
        <figcaption><span>${title} (${unit})</span><output></output></figcaption></figure>`)}</div>`;
  }

  _chart(element, plot, lines, colours) {
    const output = element.querySelector("output");
    const axis = { stroke: colours.text, grid: { stroke: colours.grid, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const limits = plot.separation
      ? [{ label: "fleet", stroke: colours.text, width: 2.5 }, { label: "limit", stroke: colours.critical, width: 1.5, dash: [8, 4] }]
      : [];
    const options = {
      width: 200,
      height: 100,
      padding: [8, 32, 0, 0],
      legend: { show: false },
      cursor: { sync: { key: "plots" }, drag: { x: false, y: false }, points: { size: 6 } },
      scales: {
        x: { range: () => [(this._shownS ?? this._spanS) - this._spanS, this._shownS ?? this._spanS] },
        y: { range: (_, low, high) => rangeOf(low, high) },
      },
      axes: [
        {
          ...axis,
          size: 24,
          splits: (_, __, low, high) => multiples(TICKS_S[this._spanS], low, high),
          values: (_, times) => times.map((timeS) => clock(timeS).slice(0, this._spanS > 60 ? 5 : 8)),
        },
        { ...axis, size: 42, space: 24 },
      ],
      series: [{}, ...lines, ...limits].map((line) => ({ ...line, points: { show: false } })),
      hooks: {
        draw: [(chart) => this._drawCommands(chart, colours)],
        setCursor: [(chart) => (output.textContent = readout(chart, plot))],
      },
    };
    return new uPlot(options, [[], ...lines.map(() => []), ...limits.map(() => [])], element);
  }

  _drawCommands(chart, colours) {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.strokeStyle = colours.accent;
    ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
    for (const timeS of this._commands ?? []) {
      if (timeS < chart.scales.x.min || timeS > chart.scales.x.max) continue;
      const x = chart.valToPos(timeS, "x", true);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  _fit() {
    for (const chart of this._charts) {
      const figure = chart.root.parentElement;
      const caption = figure.querySelector("figcaption").offsetHeight;
      const [width, height] = [figure.clientWidth, figure.clientHeight - caption];
      if (width > 60 && height > 40 && (chart.width !== width || chart.height !== height)) chart.setSize({ width, height });
    }
  }
}

function multiples(step, low, high) {
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.max(0, Math.floor(high / step) - first + 1) }, (_, i) => (first + i) * step);
}

/** Some room about the lines, and never a scale that makes noise look like motion. */
function rangeOf(low, high) {
  if (low === null || high === null || !Number.isFinite(low)) return [0, 1];
  const [least, most] = [Math.min(low, 0), Math.max(high, 0.1)];
  return [least, most + (most - least) * 0.08];
}

/** The values under the cursor. */
function readout(chart, plot) {
  const { idx } = chart.cursor;
  if (idx === null || idx === undefined) return "";
  const values = chart.series.slice(1).map((line, i) => [line.label, chart.data[i + 1][idx]]);
  const shown = values.filter(([label, value]) => value !== null && value !== undefined && label !== "limit").slice(0, 5);
  return shown.map(([label, value]) => `${label}: ${number(value, plot.digits)}`).join("  ");
}
