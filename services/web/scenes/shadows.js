// The shadows of the things in the scene, on its floor. One is worked out anew only when its thing was turned, scaled, lifted or replaced.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { isLoaded } from './scene-item.js';
import { ContactShadow } from '../graphics/contact-shadow.js';

/** @import { LoadedItem } from './scene-item.js' */

/**
 * A shadow, and the thing as it was when the shadow was worked out.
 * @typedef {object} Cast
 * @property {ContactShadow} shadow
 * @property {boolean} isReady whether the graphics card has its shader
 * @property {THREE.Object3D | undefined} level
 * @property {THREE.Matrix4} pose of the thing, without where it stands on the floor
 * @property {THREE.Vector3} offset of the shadow from the thing
 */

/** The shadows of all things. */
export class Shadows {
  #root;
  #prepare;
  #redraw;
  /** @type {Map<LoadedItem, Cast>} */
  #casts = new Map();

  /**
   * @param {THREE.Object3D} root whose floor they lie on
   * @param {(shadow: THREE.Object3D) => Promise<void>} prepare makes what the graphics card needs
   * @param {() => void} redraw called when a shadow is ready: on a slow machine no frame may be due any more
   */
  constructor(root, prepare, redraw) {
    this.#root = root;
    this.#prepare = prepare;
    this.#redraw = redraw;
  }

  /**
   * Brings the shadows to where the things are. To be called before each frame.
   * @param {LoadedItem[]} items
   * @param {(item: LoadedItem) => boolean} isShown
   */
  update(items, isShown) {
    for (const [item, { shadow }] of this.#casts) {
      if (items.includes(item)) continue;
      shadow.dispose();
      this.#casts.delete(item);
    }
    for (const item of items) {
      const standsOnIt = !item.isTiled && !item.isWalkable; // what people walk in has a floor of its own
      if (standsOnIt && isShown(item)) this.#show(item, this.#castOf(item));
      else this.#hide(item);
    }
  }

  /** @param {LoadedItem} item */
  #hide(item) {
    const cast = this.#casts.get(item);
    if (cast) cast.shadow.object.visible = false;
  }

  /**
   * @param {LoadedItem} item
   * @param {Cast} cast
   */
  #show(item, cast) {
    if (!cast.isReady) return; // then it is not the thing's first frame either, which has enough to do
    this.#workOut(item, cast);
    const { position } = item.group;
    cast.shadow.object.position.set(position.x, 0, position.z).add(cast.offset);
    cast.shadow.object.visible = true;
  }

  /**
   * Works a shadow out anew where its thing has changed.
   * @param {LoadedItem} item
   * @param {Cast} cast
   */
  #workOut(item, cast) {
    const found = changeOf(item, cast);
    if (!found) return;
    cast.shadow.cast(found.level, this.#root.matrixWorld.clone().invert());
    keep(cast, found);
  }

  /**
   * Works out the first shadow of a thing, between frames.
   * @param {LoadedItem} item
   * @param {Cast} cast
   */
  async #workOutFirst(item, cast) {
    const found = isLoaded(item) ? changeOf(item, cast) : null;
    if (!found) return;
    await cast.shadow.castInParts(found.level, this.#root.matrixWorld.clone().invert());
    keep(cast, found);
  }

  /** @param {LoadedItem} item */
  #castOf(item) {
    const known = this.#casts.get(item);
    if (known) return known;
    /** @type {Cast} */
    const cast = {
      shadow: new ContactShadow(),
      isReady: false,
      level: undefined,
      pose: new THREE.Matrix4(),
      offset: new THREE.Vector3(),
    };
    this.#casts.set(item, cast);
    cast.shadow.object.visible = false;
    this.#root.add(cast.shadow.object);
    this.#prepare(cast.shadow.object).then(async () => {
      await this.#workOutFirst(item, cast);
      cast.isReady = true;
      this.#redraw();
    });
    return cast;
  }
}

/**
 * A thing as its shadow was not worked out yet: its coarsest level, how it is held, and where it is; null where nothing has changed.
 * @param {LoadedItem} item
 * @param {Cast} cast
 */
function changeOf({ group, model }, cast) {
  const pose = group.matrix
    .compose(group.position, group.quaternion, group.scale)
    .clone()
    .setPosition(0, group.position.y, 0);
  const level = model.coarsest;
  return level && (level !== cast.level || !pose.equals(cast.pose))
    ? { level, pose, position: group.position.clone() }
    : null;
}

/**
 * Remembers of what a shadow is.
 * @param {Cast} cast
 * @param {NonNullable<ReturnType<typeof changeOf>>} found
 */
function keep(cast, { level, pose, position }) {
  Object.assign(cast, { level, pose, offset: cast.shadow.object.position.clone().sub(position).setY(0) });
}
