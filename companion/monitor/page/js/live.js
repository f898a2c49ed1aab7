/** The WebSocket to the server: snapshots in, seek and speed of a replay out. It connects again by itself. */

import { liveProtocols, whyNoPlace } from "./api.js";

const FIRST_RETRY_MS = 300;
const LONGEST_RETRY_MS = 2000;
const SILENT_AFTER_MS = 3000; // TCP alone would notice a lost server only after minutes

export class LiveConnection {
  /** `onSnapshot(snapshot, arrivedMs)`; `onOpen()` after each connect; `onRefused(reason)` after one that failed, or "". */
  constructor(onSnapshot, onOpen, onRefused) {
    this._onSnapshot = onSnapshot;
    this._onOpen = onOpen;
    this._onRefused = onRefused;
    this._plainly = false; // without subprotocols, as the last try with them did not open
    this._retryMs = FIRST_RETRY_MS;
    this._socket = null;
    this._heardMs = 0;
    setInterval(() => this._watch(), 500);
    this._connect();
  }

  send(message) {
    if (this._socket?.readyState === WebSocket.OPEN) this._socket.send(JSON.stringify(message));
  }

  _connect() {
    const url = new URL("api/v1/live", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    const protocols = this._plainly ? [] : liveProtocols();
    const socket = new WebSocket(url, protocols);
    this._socket = socket;
    let opened = false;
    this._heardMs = performance.now();
    socket.onopen = () => {
      opened = true;
      this._retryMs = FIRST_RETRY_MS;
      this._onOpen();
    };
    socket.onmessage = (event) => this._receive(socket, event.data);
    socket.onclose = () => {
      if (!opened) this._notOpened(protocols);
      this._lose(socket);
    };
  }

  /** What is between may drop the subprotocols, and then the browser takes no connection that has offered some. */
  _notOpened(protocols) {
    this._plainly = protocols.length > 0;
    whyNoPlace().then((reason) => {
      if (this._socket?.readyState !== WebSocket.OPEN) this._onRefused(reason);
    });
  }

  _receive(socket, text) {
    if (socket !== this._socket) return;
    const arrivedMs = performance.now();
    this._heardMs = arrivedMs;
    const message = JSON.parse(text);
    if (message.type === "snapshot") this._onSnapshot(message, arrivedMs);
  }

  _watch() {
    if (this._socket && performance.now() - this._heardMs > SILENT_AFTER_MS) this._lose(this._socket);
  }

  _lose(socket) {
    if (socket !== this._socket) return;
    this._socket = null;
    socket.close();
    setTimeout(() => this._connect(), this._retryMs);
    this._retryMs = Math.min(LONGEST_RETRY_MS, this._retryMs * 2);
  }
}
