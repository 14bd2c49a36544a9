// Periods that end now, for whatever has a history.

const HOUR = 3600e3; // ms
const LENGTHS = { hour: HOUR, day: 24 * HOUR, week: 168 * HOUR, month: 720 * HOUR, year: 8760 * HOUR };
const TITLES = { hour: "last hour", day: "last day", week: "last week", month: "last 30 days", year: "last 365 days" };

// Choices of a select: `open` is what is shown without a period.
export const periods = (open) => [["", open], ...Object.entries(TITLES)];

// The query that asks for a period of that name, with what leads it; nothing for an open one.
export const since = (period, lead = "&") =>
  period in LENGTHS ? `${lead}from=${encodeURIComponent(new Date(Date.now() - LENGTHS[period]).toISOString())}` : "";
