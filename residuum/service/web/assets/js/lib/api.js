// Calls of the public HTTP interface; a refusal becomes an error with the problem document's one line.

const BASE = "/api/v1";
const KEY = "residuum-api-key";

export class Problem extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

export const apiKey = {
  get: () => sessionStorage.getItem(KEY),
  set: (key) => sessionStorage.setItem(KEY, key),
};

export function headers(more = {}) {
  const key = apiKey.get();
  return key ? { ...more, Authorization: `Bearer ${key}` } : more;
}

// `body` travels as JSON, `file` as the bytes it has.
export async function call(path, { method = "GET", body, file, signal } = {}) {
  const options = { method, signal, headers: headers(body === undefined ? {} : { "Content-Type": "application/json" }) };
  if (body !== undefined || file !== undefined) options.body = file ?? JSON.stringify(body);
  let response;
  try {
    response = await fetch(BASE + path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, "The service does not answer.");
  }
  const content = await response.json().catch((error) => {
    if (error.name === "AbortError") throw error;
    return null;
  });
  if (response.ok) {
    if (method !== "GET") document.dispatchEvent(new CustomEvent("succeeded"));
    return content;
  }
  const refusal = content?.detail ?? `The service answered ${response.status}.`;
  if (response.status === 401) document.dispatchEvent(new CustomEvent("key-needed", { detail: refusal }));
  throw new Problem(response.status, refusal);
}

export const path = (...parts) => `/${parts.map((part) => encodeURIComponent(part)).join("/")}`;

let interfaceRead = null;

// The OpenAPI document of the interface, read once.
export function described() {
  interfaceRead ??= fetch("/openapi.json").then((response) => {
    if (!response.ok) throw new Problem(response.status, `The service answered ${response.status}.`);
    return response.json();
  });
  interfaceRead.catch(() => {
    interfaceRead = null;
  });
  return interfaceRead;
}
