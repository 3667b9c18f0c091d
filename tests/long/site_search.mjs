// The answers of the web site's search: node site_search.mjs SITE QUERY... prints one JSON object, the places by query.
// Runs the search worker of the built site with the site's own index.
import fs from "fs";
import vm from "vm";

const [site, ...queries] = process.argv.slice(2);
const folder = `${site}/assets/javascripts/workers/`;
const worker = fs.readdirSync(folder).find((name) => name.endsWith(".min.js"));
const index = JSON.parse(fs.readFileSync(`${site}/search/search_index.json`, "utf8"));
let receive;
let answered;
Object.assign(globalThis, {
  self: globalThis,
  importScripts() {},
  addEventListener: (_, handler) => (receive = handler),
  postMessage: (message) => answered(message.data),
});
vm.runInThisContext(fs.readFileSync(folder + worker, "utf8"));

const SETUP = 0;
const QUERY = 2;
const send = (type, data) =>
  new Promise((resolve) => {
    answered = resolve;
    receive({ data: { type, data } });
  });
await send(SETUP, { ...index, options: {} });
const found = {};
for (const query of queries) {
  found[query] = (await send(QUERY, query)).items.flat().map((item) => item.location);
}
console.log(JSON.stringify(found));
