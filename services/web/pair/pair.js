// The pairing page (/pair): shows a QR code and ten digits to somebody who is logged in; logs in the phone that scans the code, which opens
// this page with the pairing's token behind the # of its address.
import { claim } from './claim.js';
import { invite } from './invitation.js';
import { page, showState } from './page-state.js';
import { showAccount } from '../shared/account.js';
import { sentences } from '../shared/problems.js';

document.body.dataset.started = 'yes';
const token = location.hash.slice(1);
history.replaceState(null, '', location.pathname); // the token works once, but need not stay in the history
(token ? claim(token) : invite())
  .catch((error) => {
    showState('error', sentences(error));
    page.other.hidden = false;
  })
  .finally(showAccount);
