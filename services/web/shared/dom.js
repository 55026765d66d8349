// Finding and creating the elements of a page.

/**
 * Finds an element by its id. Throws an Error that names the id where there is none, or where it is of another class.
 * @template {Element} T
 * @param {string} id
 * @param {new () => T} type its class, such as HTMLButtonElement
 * @returns {T}
 */
export function element(id, type) {
  const found = document.getElementById(id);
  if (found instanceof type) return found;
  throw new Error(`The page has no ${type.name} with the id "${id}".`);
}

/**
 * Finds the first element inside another by its CSS selector. Throws an Error that names the selector where there is none.
 * @template {Element} T
 * @param {Element} parent
 * @param {string} selector
 * @param {new () => T} type its class
 * @returns {T}
 */
export function child(parent, selector, type) {
  const found = parent.querySelector(selector);
  if (found instanceof type) return found;
  throw new Error(`The page has no ${type.name} that matches "${selector}".`);
}

/**
 * Creates an element and sets its properties.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Partial<HTMLElementTagNameMap[K]>} [properties]
 * @returns {HTMLElementTagNameMap[K]}
 */
export function create(tag, properties = {}) {
  return Object.assign(document.createElement(tag), properties);
}

/**
 * Replaces the items of a list by these lines of text.
 * @param {HTMLElement} list
 * @param {string[]} lines
 */
export function fillList(list, lines) {
  list.replaceChildren(...lines.map((line) => create('li', { textContent: line })));
}
