// Khronos' verdict on the files named on the command line, as one JSON array: {errors, warnings, infos, hints, messages}.
import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';

// The validator lies in the folder this script is run from, which need not be the script's own.
const validator = createRequire(`${process.cwd()}/`)('gltf-validator');

const verdicts = [];
for (const path of process.argv.slice(2)) {
  const { issues } = await validator.validateBytes(new Uint8Array(await readFile(path)));
  verdicts.push({
    errors: issues.numErrors,
    warnings: issues.numWarnings,
    infos: issues.numInfos,
    hints: issues.numHints,
    messages: issues.messages.map(({ code, message, pointer }) => `${code} ${pointer}: ${message}`),
  });
}
console.log(JSON.stringify(verdicts));
