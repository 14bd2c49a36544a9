// The catalogue's titles of effects, read once: an id such as `lugre` does not say how its name is written (LuGre friction).

import { call } from "./api.js";
import { title } from "./format.js";

const titles = new Map();

export async function readEffectTitles() {
  for (const { effect, title: text } of (await call("/effects")).items) titles.set(effect, text);
}

// What is not in the catalogue (a fault, an effect of a model's own) is its id in words.

export const effectTitle = (id) => titles.get(id) ?? title(id);
