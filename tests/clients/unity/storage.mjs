// Links the WebGL player's plugin as Emscripten does, to a file system whose copies end when this says so. Prints how many
// copies have begun after each step.
import { readFileSync } from 'node:fs';

const copies = [];
const library = {};
const scope = {
  FS: { syncfs: (_populate, done) => copies.push(done) },
  LibraryManager: { library },
  autoAddDeps: () => {},
  console: { warn: () => {} },
  mergeInto: (into, more) => Object.assign(into, more),
};
new Function(...Object.keys(scope), readFileSync(process.argv[2], 'utf8'))(...Object.values(scope));
globalThis.capture2vrStorage = library.$capture2vrStorage; // what its "$" means to Emscripten
const flush = library.Capture2vrFlush;

const begun = [];
const step = (act) => {
  act();
  begun.push(copies.length);
};
step(flush);
step(flush); // while the first copy is under way
step(flush);
step(() => copies[0](null)); // one more, for both
step(() => copies[1]('QuotaExceededError'));
step(flush); // a failure is not the end
console.log(JSON.stringify(begun));
