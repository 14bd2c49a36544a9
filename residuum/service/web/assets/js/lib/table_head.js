// A table's head: a column a label, those of `numbers` (by index) set to the right; no label leaves a corner empty.

import { h } from "./dom.js";

export const tableHead = (labels, numbers = []) =>
  h(
    "thead",
    {},
    h(
      "tr",
      {},
      labels.map((label, index) =>
        label ? h("th", { scope: "col", class: numbers.includes(index) ? "number" : null }, label) : h("td"),
      ),
    ),
  );
