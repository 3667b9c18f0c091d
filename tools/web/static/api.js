// Asking the interface; errors are its own words.

const CACHE = new Map();

export async function get(path) {
  const answer = await fetch(path, { cache: "no-store" });
  const document = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error(document.error ?? `${answer.status} ${answer.statusText}`);
  return document;
}

// What does not change while the page is open.
export function getOnce(path) {
  if (!CACHE.has(path)) {
    CACHE.set(path, get(path).catch((error) => {
      CACHE.delete(path);
      throw error;
    }));
  }
  return CACHE.get(path);
}
