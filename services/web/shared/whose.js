// Whose things a page shows, and for whom: the tenant in the page's address, and the one that is logged in.

const TENANT_COOKIE = /(?:^|;\s*)c2v_tenant=([a-z0-9-]+)/; // beside the session's cookie, which scripts cannot read

/** The tenant that is logged in in this browser, as known without the server; '' where nobody is. */
export const ownTenant = () => TENANT_COOKIE.exec(document.cookie)?.[1] ?? '';

const tenantAtStart = ownTenant();

/**
 * Loads the page again where another tenant has logged in since, in another tab: what was shown and chosen is not of that one's things.
 * @returns {boolean} whether it does
 */
export function reloadForOtherTenant() {
  if (ownTenant() === tenantAtStart) return false;
  location.reload();
  return true;
}

/**
 * Whether another tenant has logged in since, in another tab: what this page shows is not of that one's things.
 * @returns {boolean}
 */
export const hasOtherTenant = () => tenantAtStart !== '' && ownTenant() !== '' && ownTenant() !== tenantAtStart;

/** The tenant in the page's address; '' in most addresses of one's own pages. */
const tenantInAddress = new URLSearchParams(location.search).get('tenant') ?? '';

/** The tenant whose things a visitor sees; '' on one's own pages, whatever their address. */
const shownTenant = tenantInAddress === ownTenant() ? '' : tenantInAddress;

/**
 * Shows a page of one's own things as a visitor sees them, where its address allows it: after the session has ended, some may still be shared.
 * @returns {boolean} whether it does
 */
export function showAsVisitor() {
  if (!tenantInAddress || shownTenant) return false;
  document.cookie = 'c2v_tenant=; path=/; max-age=0';
  if (ownTenant()) return false;
  location.reload();
  return true;
}

/**
 * An address of the API or of a page, of the tenant whose things this page shows.
 * @param {string} address
 * @returns {string}
 */
export function ofShownTenant(address) {
  return shownTenant
    ? `${address}${address.includes('?') ? '&' : '?'}tenant=${encodeURIComponent(shownTenant)}`
    : address;
}

/**
 * The name of a cache or of a stored item for who is logged in: another user of the same browser does not see what is in it.
 * @param {string} name
 * @returns {string}
 */
export function ownName(name) {
  const tenant = ownTenant();
  return tenant ? `${name}:${tenant}` : name;
}

/**
 * The same, of the tenant whose things this page shows.
 * @param {string} name
 * @returns {string}
 */
export const ownNameOfShown = (name) => ownName(shownTenant ? `${name}@${shownTenant}` : name);
