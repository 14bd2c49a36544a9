// Models as the workbench's steps name and read them.

import { call, path } from "../lib/api.js";

export function describe(model, version) {
  return call(path("models", model, "description") + (version ? `?version=${version}` : ""));
}

export const modelTitle = (model, version) => `${model}${version ? `, version ${version}` : ""}`;
