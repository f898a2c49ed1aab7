/** Asked by test_clipped.py in the page: which texts are cut off, which are too pale, and what axe-core finds. */

(() => {
  const TEXT_RATIO = 4.5;
  const SHAPE_RATIO = 3; // WCAG 1.4.11: what is no text
  const GROUND_PX = 10; // the size of texts that lie below the vehicles
  const drawn = new Map(); // what the canvases have written, by its colours
  let onMap = []; // the texts of the frame of the map that is being drawn, with their boxes
  let shownOnMap = []; // those of the last whole frame

  const frame = () => new Promise((done) => requestAnimationFrame(done));
  const written = (e) => e.matches("input, select") || [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
  const texts = () => [...document.querySelectorAll("body *")].filter((e) => e.checkVisibility() && written(e)
    && !e.closest(".unseen, .skip, script, svg, dialog:not([open]), noscript"));
  const named = (e) => `${e.tagName}.${e.className.baseVal ?? e.className} in #${e.closest("[id]")?.id}: `
    + (e.value || e.textContent).trim().slice(0, 40);

  /**
   * A text is cut off where it is wider than its box, or its box than one around it that hides the rest. Meant are: what
   * scrolls, and an ellipsis with a title.
   */
  function cutOff() {
    const style = (e) => getComputedStyle(e);
    const meant = (e) => ["auto", "scroll"].includes(style(e).overflowX)
      || (style(e).textOverflow === "ellipsis" && e.closest("[title]"));
    const pen = new OffscreenCanvas(1, 1).getContext("2d");
    const width = (e, text) => { pen.font = style(e).font; return pen.measureText(text).width; };
    const inner = (e) => e.clientWidth - parseFloat(style(e).paddingLeft) - parseFloat(style(e).paddingRight);
    const field = (e) => e.matches("input:not([type]), input[type=text], input[type=number]") && width(e, e.value) > inner(e) + 1;
    const wide = (e) => e.scrollWidth > e.clientWidth + 1 && style(e).overflowX !== "visible" && !meant(e);
    const hidden = (e) => {
      const { right, left } = e.getBoundingClientRect();
      for (let around = e.parentElement; around; around = around.parentElement) {
        if (meant(around)) return false;
        if (style(around).overflowX === "visible") continue;
        const box = around.getBoundingClientRect();
        if (right > box.right + 1 || left < box.left - 1) return true;
      }
      return right > innerWidth + 1;
    };
    const found = texts().filter((e) => field(e) || wide(e) || hidden(e)).map((e) => `cut off: ${named(e)}`);
    return found.concat(crowdedInTimeline());
  }

  const ofTimeline = () => [...document.querySelectorAll(".timeline text")].filter((e) => e.checkVisibility());
  const meet = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

  function crowdedInTimeline() {
    const boxes = ofTimeline().map((e) => {
      const { left, top, right, bottom } = e.getBoundingClientRect();
      return [left + 0.5, top + 2, right - 0.5, bottom - 2, e];
    });
    const pairs = boxes.flatMap((one, i) => boxes.slice(0, i).filter((other) => meet(one, other)).map((other) => [one, other]));
    const outside = boxes.filter(([, , right, , e]) => right > e.ownerSVGElement.getBoundingClientRect().right + 1);
    const texts = pairs.map((pair) => `overlap: ${pair.map((box) => box[4].textContent).join(" and ")}`);
    return texts.concat(outside.map((box) => `cut off: ${box[4].textContent}`));
  }

  /** [red, green, blue, alpha] of #rrggbb, rgb(...) and rgba(...). */
  function parsed(colour) {
    if (colour.startsWith("#")) return [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16)).concat(1);
    const [r, g, b, a = 1] = colour.match(/[\d.]+/g).map(Number);
    return [r, g, b, a];
  }

  const over = (top, below) => [0, 1, 2].map((i) => top[i] * top[3] + below[i] * (1 - top[3])).concat(1);

  function luminance(colour) {
    const [r, g, b] = colour.map((value) => (value / 255 <= 0.04045 ? value / 255 / 12.92 : ((value / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  }

  function ratio(a, b) {
    const [dark, light] = [luminance(a), luminance(b)].sort((x, y) => x - y);
    return (light + 0.05) / (dark + 0.05);
  }

  /** The colours behind an element: several of a gradient. */
  function behind(element) {
    let tops = [[0, 0, 0, 0]];
    for (let e = element; e; e = e.parentElement) {
      const { backgroundColor, backgroundImage } = getComputedStyle(e);
      const stripes = backgroundImage.match(/rgba?\([^)]*\)/g);
      const own = (stripes ?? [backgroundColor]).map(parsed);
      tops = tops.flatMap((top) => (top[3] === 1 ? [top] : own.map((below) => (top[3] ? over(top, below) : below))));
      if (tops.every((top) => top[3] === 1)) break;
    }
    return tops;
  }

  function opacityOf(element) {
    let opacity = 1;
    for (let e = element; e; e = e.parentElement) {
      const style = getComputedStyle(e);
      opacity *= Number(style.opacity) * Number(style.filter.match(/opacity\(([\d.]+)\)/)?.[1] ?? 1);
    }
    return opacity;
  }

  function least(element, colour, opacity) {
    const [r, g, b, a] = parsed(colour);
    const alpha = a * opacity;
    return Math.min(...behind(element).map((below) => ratio(over([r, g, b, alpha], below), below)));
  }

  /** Also what axe-core leaves out: signs, and texts below others. A disabled button may be pale, and a symbol of before. */
  function pale() {
    const enabled = texts().filter((e) => !e.closest(":disabled, label:has(:disabled)"));
    const found = enabled.map((e) => [least(e, getComputedStyle(e).color, opacityOf(e)), TEXT_RATIO, e]);
    for (const e of ofTimeline()) {
      const span = e.closest(".span")?.querySelector("rect");
      const fill = span ? getComputedStyle(span).fill : "none";
      const below = fill === "none" ? behind(e.ownerSVGElement.parentElement) : [parsed(fill)];
      found.push([Math.min(...below.map((one) => ratio(parsed(getComputedStyle(e).fill), one))), TEXT_RATIO, e]);
    }
    const symbols = [...document.querySelectorAll(".symbol path, .plot-key line")].filter((e) => e.checkVisibility());
    const strokes = symbols.map((e) => [e, getComputedStyle(e).stroke]);
    found.push(...strokes.map(([e, stroke]) => [least(e.closest("svg").parentElement, stroke, 1), SHAPE_RATIO, e]));
    return found.filter(([value, limit]) => value < limit).map(([value, , e]) => `contrast ${value.toFixed(2)}: ${named(e)}`);
  }

  /** A text with an outline is read against it, one on a symbol against the colour of that, any other against the panel. */
  function watchCanvases() {
    const own = CanvasRenderingContext2D.prototype;
    const { fill, fillRect, fillText, strokeText } = own;
    const filled = new WeakMap();
    const outlined = new WeakMap();
    own.fill = function (...args) {
      filled.set(this, this.fillStyle);
      return fill.apply(this, args);
    };
    own.fillRect = function (...args) {
      if (this.canvas.id === "scene") [shownOnMap, onMap] = [onMap, []]; // the map begins with its ground
      return fillRect.apply(this, args);
    };
    own.strokeText = function (text, ...args) {
      outlined.set(this, [text, this.strokeStyle]);
      return strokeText.call(this, text, ...args);
    };
    own.fillText = function (text, ...args) {
      const [outlinedText, outline] = outlined.get(this) ?? [];
      const isMap = this.canvas.id === "scene";
      if (isMap) onMap.push({ text, box: boxOf(this, text, ...args), sizePx: Number(this.font.match(/([\d.]+)px/)[1]) });
      const below = !isMap ? getComputedStyle(this.canvas.closest(".panel")).backgroundColor
        : outlinedText === text ? outline : filled.get(this);
      outlined.delete(this);
      filled.set(this, this.fillStyle);
      const [r, g, b, a] = parsed(this.fillStyle);
      const colours = [over([r, g, b, a * this.globalAlpha], parsed(below)), parsed(below)];
      drawn.set(`${this.fillStyle} on ${below}`, [ratio(...colours), text]);
      return fillText.call(this, text, ...args);
    };
  }

  /** [left, top, right, bottom] of a text in the middle of a place. */
  function boxOf(context, text, x, y) {
    const { width, actualBoundingBoxAscent: up, actualBoundingBoxDescent: down } = context.measureText(text);
    return [x - width / 2, y - up, x + width / 2, y + down];
  }

  /** Pairs of texts on the map that overlap, without those of the ground below the vehicles; without ids where symbols overlap. */
  function overlapping({ ids }) {
    const seen = shownOnMap.filter(({ text, sizePx }) => sizePx > GROUND_PX && !(ids ? /^[A-Z▲]$/ : /^\d+$|^.$/).test(text));
    const pairs = seen.flatMap((one, i) => seen.slice(0, i).map((other) => [one, other]));
    return pairs.filter(([one, other]) => meet(one.box, other.box)).map((pair) => pair.map(({ text }) => text).join(" and "));
  }

  /** Of what canvases write from now on, in the colours of now. */
  async function drawnPale() {
    for (let i = 0; i < 5; i += 1) await frame(); // another theme is drawn within them
    drawn.clear();
    for (let i = 0; i < 60 && drawn.size < 2; i += 1) await frame();
    const none = drawn.size ? [] : ["no text on a canvas"]; // then this would see nothing
    const found = [...drawn].filter(([, [value]]) => value < TEXT_RATIO);
    return none.concat(found.map(([colours, [value, text]]) => `contrast ${value.toFixed(2)} of ${colours}: "${text}"`));
  }

  async function violations() {
    const options = { runOnly: ["wcag2a", "wcag2aa"], resultTypes: ["violations"] };
    const result = await globalThis.axe.run(document, options);
    return result.violations.flatMap(({ id, nodes }) => nodes.map((n) => `${id}: ${n.target} ${n.failureSummary}`));
  }

  /** In each tab of a narrow page. What was found, as "TAB: TEXT". */
  async function inEachTab(checks) {
    const tabs = [...document.querySelectorAll("#tabs button")].filter((tab) => tab.checkVisibility());
    const found = [];
    for (let i = 0; i < 3; i += 1) await frame(); // panels are drawn in the third
    for (const tab of tabs.length ? tabs : [null]) {
      tab?.click();
      await frame();
      for (const check of checks) found.push(...(await check()).map((text) => `${tab?.textContent ?? "page"}: ${text}`));
    }
    return found;
  }

  watchCanvases();
  globalThis.readable = {
    overlapping,
    onMap: () => shownOnMap.map(({ text }) => text),
    cutOff: () => inEachTab([cutOff]),
    colours: async () => [...(await drawnPale()), ...(await inEachTab([pale, violations]))],
  };
})();
