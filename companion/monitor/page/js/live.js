/** The WebSocket to the server: snapshots in, seek and speed of a replay out. It connects again by itself. */

const FIRST_RETRY_MS = 300;
const LONGEST_RETRY_MS = 2000;
const SILENT_AFTER_MS = 3000; // TCP alone would notice a lost server only after minutes

export class LiveConnection {
  /** `onSnapshot(snapshot, arrivedMs)`; `onOpen()` after each connect. */
  constructor(onSnapshot, onOpen) {
    this._onSnapshot = onSnapshot;
    this._onOpen = onOpen;
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
    const socket = new WebSocket(url);
    this._socket = socket;
    this._heardMs = performance.now();
    socket.onopen = () => {
      this._retryMs = FIRST_RETRY_MS;
      this._onOpen();
    };
    socket.onmessage = (event) => this._receive(socket, event.data);
    socket.onclose = () => this._lose(socket);
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
