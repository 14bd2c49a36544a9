// Balances typeset as MathML, from the expression trees of a model's description.

const MATH = "http://www.w3.org/1998/Math/MathML";
const GREEK = {
  alpha: "α",
  beta: "β",
  gamma: "γ",
  delta: "δ",
  epsilon: "ε",
  eta: "η",
  theta: "θ",
  kappa: "κ",
  lambda: "λ",
  mu: "μ",
  nu: "ν",
  xi: "ξ",
  rho: "ρ",
  sigma: "σ",
  tau: "τ",
  phi: "φ",
  chi: "χ",
  psi: "ψ",
  omega: "ω",
  Delta: "Δ",
  Omega: "Ω",
  Theta: "Θ",
  Phi: "Φ",
};
const STRENGTH = {
  "<": 0,
  "<=": 0,
  ">": 0,
  ">=": 0,
  "==": 0,
  "!=": 0,
  and: 0,
  or: 0,
  not: 0,
  "+": 1,
  "-": 1,
  "*": 2,
  "/": 3,
  neg: 2,
  "**": 4,
};

function m(tag, ...children) {
  const element = document.createElementNS(MATH, tag);
  element.append(...children.flat());
  return element;
}

const operator = (text) => m("mo", text);

function name(text) {
  const [head, ...below] = text.split("_");
  const letter = m("mi", GREEK[head] ?? head);
  return below.length && below.join("")
    ? m("msub", letter, m("mtext", below.map((part) => GREEK[part] ?? part).join(", ")))
    : letter;
}

const strength = (tree) => (Array.isArray(tree) ? (STRENGTH[tree[0]] ?? 5) : tree < 0 ? 1 : 5);
const inside = (tree, least) => (strength(tree) < least ? [operator("("), typeset(tree), operator(")")] : [typeset(tree)]);

const SHAPES = {
  "+": (a, b) => m("mrow", typeset(a), operator("+"), inside(b, 1)),
  "-": (a, b) => m("mrow", typeset(a), operator("−"), inside(b, 2)),
  "*": (a, b) => m("mrow", inside(a, 2), operator("·"), inside(b, 2)),
  "/": (a, b) => m("mfrac", typeset(a), typeset(b)),
  "**": (a, b) => m("msup", m("mrow", inside(a, 5)), typeset(b)),
  neg: (a) => m("mrow", operator("−"), inside(a, 2)),
  der: (a) => m("mover", typeset(a), operator("˙")),
  sqrt: (a) => m("msqrt", typeset(a)),
  abs: (a) => m("mrow", operator("|"), typeset(a), operator("|")),
  not: (a) => m("mrow", operator("not"), inside(a, 5)),
  "[]": (...values) => m("mrow", operator("["), listed(values), operator("]")),
};
for (const [sign, shown] of Object.entries({ "<": "<", "<=": "≤", ">": ">", ">=": "≥", "==": "=", "!=": "≠" }))
  SHAPES[sign] = (a, b) => m("mrow", typeset(a), operator(shown), typeset(b));
for (const word of ["and", "or"]) SHAPES[word] = (a, b) => m("mrow", inside(a, 5), operator(word), inside(b, 5));

const listed = (operands) =>
  operands.flatMap((operand, index) => (index ? [operator(","), typeset(operand)] : [typeset(operand)]));

export function typeset(tree) {
  if (typeof tree === "number") return m("mn", String(Number(tree.toPrecision(6))));
  if (typeof tree === "string") return name(tree);
  const [head, ...operands] = tree;
  if (SHAPES[head]) return SHAPES[head](...operands);
  return m("mrow", m("mi", head), operator("("), listed(operands), operator(")"));
}

// The tree without the minus that its first factor carries; null when there is none.
function withoutMinus(tree) {
  if (!Array.isArray(tree)) return null;
  const [head, first, ...rest] = tree;
  if (head === "neg") return first;
  const positive = head === "*" || head === "/" ? withoutMinus(first) : null;
  return positive && [head, positive, ...rest];
}

// storage = term + term …, a negative term with its minus.
export function balanceEquation(balance, effects = []) {
  const row = m("mrow", typeset(balance.storage), operator("="));
  balance.terms.forEach(({ value }, index) => {
    const positive = withoutMinus(value);
    if (index || positive) row.append(operator(positive ? "−" : "+"));
    row.append(...(positive ? inside(positive, 2) : [typeset(value)]));
  });
  for (const effect of effects) row.append(operator(/^[−-]/.test(effect.equation) ? "" : "+"), m("mtext", ` ${effect.equation}`));
  const math = m("math", row);
  math.setAttribute("display", "block");
  return math;
}
