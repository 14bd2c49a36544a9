// The name under which an uploaded model file is stored: the file's own, in the letters that the service takes.

export const modelName = (file) =>
  file
    .replace(/\.[^.]*$/, "")
    .replace(/[^A-Za-z0-9._-]+/g, "-")
    .replace(/^[^A-Za-z0-9]+/, "")
    .slice(0, 64) || "model";
