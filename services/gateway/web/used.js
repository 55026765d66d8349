// Which photos an asset was made of, and why the others were left out.

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
