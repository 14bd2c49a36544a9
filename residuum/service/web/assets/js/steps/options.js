// What a step asks of the bench's model and records, with the options that are kept in the address.

import { h } from "../lib/dom.js";
import { adapted, fieldsOf, questionForm } from "../lib/question_form.js";

const OF_THE_BENCH = ["records", "version", "map"];

/**
 * The question at `/models/{model}/<noun>`: `{form, body}`. `again()` is called when its form is sent; `first`, `submit` and
 * `known` are those of a form that is no mere fold, `without` what the step says itself.
 */
export async function optionsOf(bench, noun, again, { first = [], submit = "Ask again", without = [], known = {} } = {}) {
  const fields = adapted(await fieldsOf(`/models/{model}/${noun}`), [...OF_THE_BENCH, ...without], known);
  const asked = { ...bench.shown[noun] };
  const { form, body } = questionForm(fields, asked, {
    first,
    submit: h("button", { class: first.length ? null : "quiet", "data-key": `ask-${noun}` }, submit),
    onsubmit: () => {
      bench.show({ [noun]: asked });
      again();
    },
  });
  return { form, body: () => ({ ...bench.asked, ...body() }) };
}
