// What addressablestools reads in the catalogues named on the command line, behind its wheel: a JSON array.
import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

// The packages lie in the folder this script is run from, which need not be the script's own.
const entry = createRequire(`${process.cwd()}/`).resolve('pyodide/pyodide.mjs');
const { loadPyodide } = await import(pathToFileURL(entry));
const bytes = async (path) => new Uint8Array(await readFile(path));

const [wheel, ...catalogues] = process.argv.slice(2);
const python = await loadPyodide();
python.unpackArchive(await bytes(wheel), 'wheel');
await python.runPythonAsync(await readFile(new URL('listing.py', import.meta.url), 'utf8'));
const listed = python.globals.get('listed');
const documents = [];
for (const path of catalogues) documents.push(JSON.parse(listed(path, python.toPy(await bytes(path)))));
console.log(JSON.stringify(documents));
