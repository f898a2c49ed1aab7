/** Requests to the server. The token of `--control` comes with the URL, as `#token=...`. */

const TOKEN_KEY = "companion-token";
const PATIENCE_MS = 20000;

/** The token leaves the address bar, so that no screenshot and no bookmark has it. This tab keeps it for a reload. */
export function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(TOKEN_KEY, given);
    history.replaceState(null, "", location.pathname + location.search);
  }
  token = sessionStorage.getItem(TOKEN_KEY) ?? "";
}

let token = "";
readToken();

export const hasToken = () => token !== "";

/**
 * The subprotocols of a WebSocket, to which a page can add no header: with the token the server keeps a place for it.
 * Other characters than those of a token would be an error of the page.
 */
export const liveProtocols = () => (/^[\w-]+$/.test(token) ? ["companion", `companion.token.${token}`] : []);

/** Why the server has no place for the WebSocket of this page; "" where it has, or does not answer. */
export async function whyNoPlace() {
  const options = { headers: { "X-Companion-Token": token }, signal: AbortSignal.timeout(PATIENCE_MS) };
  try {
    const response = await fetch("api/v1/live", options);
    return response.status === 503 ? (await response.json()).error : "";
  } catch {
    return "";
  }
}

/** Whether the server would take commands of this page: each start of the server makes a new token. */
export const mayCommand = async () => hasToken() && (await get("control")).allowed;

export async function get(path) {
  return request("GET", path);
}

export const acknowledge = (alarmId) => request("POST", `alarms/${encodeURIComponent(alarmId)}/acknowledge`, {});
export const preview = (command) => request("POST", "preview", command);
export const command = (content) => request("POST", "commands", content);

/** The answer as an object. Throws an Error whose text can be shown. */
async function request(method, path, content) {
  const headers = { "X-Companion-Token": token };
  if (content !== undefined) headers["Content-Type"] = "application/json";
  const body = content === undefined ? undefined : JSON.stringify(content);
  let response;
  try {
    response = await fetch(`api/v1/${path}`, { method, headers, body, signal: AbortSignal.timeout(PATIENCE_MS) });
  } catch {
    throw new Error("no answer from the server: it is not known whether anything was sent");
  }
  const answer = await response.json().catch(() => null);
  if (!response.ok) throw new Error(answer?.error || `the server refused: ${response.status} ${response.statusText}`);
  return answer ?? {};
}
