// The way to the login page and back.

/** Leads to the login page, which comes back to this address afterwards. */
export function leadToLogin() {
  const { pathname, search, hash } = location;
  location.assign(`/login?${new URLSearchParams({ next: pathname + search + hash })}`);
}

/**
 * The address that the login page comes back to: of this site, whatever a link to the page says.
 * @param {string} search of the login page's address
 * @returns {string}
 */
export function addressAfterLogin(search) {
  const wanted = new URLSearchParams(search).get('next') ?? '/';
  try {
    const { origin, pathname, search: query, hash } = new URL(wanted, location.origin);
    const leadsAway = origin !== location.origin || pathname.startsWith('//'); // which is another site's address by itself
    return leadsAway || pathname === location.pathname ? '/' : pathname + query + hash;
  } catch {
    return '/';
  }
}
