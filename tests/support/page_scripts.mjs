// Evaluates expressions in Node, where `import('/web/…')` loads a page's module: a line of JSON in, a line of JSON out.
import { register } from 'node:module';
import { createInterface } from 'node:readline';
import { pathToFileURL } from 'node:url';

const web = pathToFileURL(`${process.argv[2]}/`).href;
// Files of pages are modules, though nothing beside them says so to Node.
const hooks = `
export async function resolve(name, context, next) {
  const url = name.startsWith('/web/') ? '${web}' + name.slice(5) : next(name, context).then((found) => found.url);
  return { url: await url, format: 'module', shortCircuit: true };
}`;
register(`data:text/javascript,${encodeURIComponent(hooks)}`);

/**
 * Calls a function, given as its source, with an argument.
 *
 * @param {string} line
 */
async function answer(line) {
  const { source, argument } = JSON.parse(line);
  try {
    const { default: call } = await import(`data:text/javascript,${encodeURIComponent(`export default ${source}`)}`);
    return { value: await call(argument) };
  } catch (error) {
    return { error: error instanceof Error ? (error.stack ?? error.message) : String(error) };
  }
}

for await (const line of createInterface({ input: process.stdin })) {
  process.stdout.write(`${JSON.stringify(await answer(line))}\n`);
}
