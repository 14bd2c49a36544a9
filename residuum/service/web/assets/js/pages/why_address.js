// Where the workbench asks what a machine's active model lacks in these windows.

import { call, path } from "../lib/api.js";

export async function whyAddress(asset, windows) {
  const { active } = await call(path("assets", asset, "model"));
  if (!active) throw new Error(`${asset} has no model yet: choose one under Watch a machine, and train with it.`);
  const { records } = await call(path("assets", asset, "records"), { method: "POST", body: { windows } });
  const asked = { records: records.join(","), model: active.model, version: active.number, step: "why" };
  return `#/workbench?${new URLSearchParams(asked)}`;
}
