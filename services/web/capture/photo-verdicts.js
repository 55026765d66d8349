// Which photos an asset was made of, why the others were left out, and from where to shoot again.

const FAULTS = {
  blur: 'blurred',
  dark: 'too dark',
  duplicate: 'a copy',
  no_overlap: 'no overlap',
  unreadable: 'unreadable',
};

/** The verdicts of a manifest's capture on `details`; nothing where it was neither photos nor a film. */
export function showUsed(details, { photos: verdicts = [], format } = {}) {
  const left = verdicts.filter(({ verdict }) => verdict !== 'ok');
  const used = verdicts.filter(({ verdict }) => verdict === 'ok');
  details.hidden = verdicts.length === 0;
  details.querySelector('summary').textContent = `Used ${used.length} of ${verdicts.length} ${format === 'video' ? 'pictures of the film' : 'photos'}`;
  details.querySelector('ul').replaceChildren(...left.map(line), ...used.map(line));
}

function line({ name, verdict, advice }) {
  const item = document.createElement('li');
  item.dataset.verdict = verdict;
  const told = verdict === 'ok' ? 'used' : (FAULTS[verdict] ?? verdict);
  item.append(Object.assign(document.createElement('strong'), { textContent: name }), ` ${told}${advice ? `. ${advice}` : ''}`);
  return item;
}

/** The sides of the thing that the capture shows too little of, on `details`; nothing where all was seen well. */
export function showUnseen(details, { unseen: sides = [] } = {}) {
  details.hidden = sides.length === 0;
  details.querySelector('ul').replaceChildren(...sides.map(({ advice }) => Object.assign(document.createElement('li'), { textContent: advice })));
}
