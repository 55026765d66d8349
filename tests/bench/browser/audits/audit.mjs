// Audits pages with Lighthouse in a browser that is running: node audit.mjs PORT ADDRESS…; one JSON line for each page.
import lighthouse from 'lighthouse';

const CATEGORIES = ['performance', 'accessibility', 'best-practices'];
const METRICS = [
  'first-contentful-paint',
  'largest-contentful-paint',
  'total-blocking-time',
  'cumulative-layout-shift',
  'speed-index',
];
const [port, ...addresses] = process.argv.slice(2);

for (const address of addresses) {
  const { lhr } = await lighthouse(address, { port: Number(port), logLevel: 'error', onlyCategories: CATEGORIES });
  const scores = Object.fromEntries(CATEGORIES.map((name) => [name, Math.round(100 * lhr.categories[name].score)]));
  const metrics = Object.fromEntries(METRICS.map((name) => [name, lhr.audits[name].numericValue]));
  const rules = lhr.categories.accessibility.auditRefs.filter(({ weight }) => weight > 0).map(({ id }) => id);
  const inaccessible = rules.filter((id) => lhr.audits[id].score === 0);
  console.log(JSON.stringify({ scores, metrics, inaccessible, bytes: lhr.audits['total-byte-weight'].numericValue }));
}
