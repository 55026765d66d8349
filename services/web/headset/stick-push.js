// A push of a thumbstick to the side, told once until the stick has come back: for what happens step by step.

const [FROM, BACK] = [0.7, 0.4]; // of the stick's way: a push, and being back from it

/** The pushes of a thumbstick. */
export class StickPush {
  #pushed = false;

  /**
   * Whether the stick was just pushed: -1 to the left, 1 to the right, else 0. To be called before each frame.
   * @param {number} x of the thumbstick: -1 left, 1 right
   */
  read(x) {
    if (Math.abs(x) < BACK) this.#pushed = false;
    if (this.#pushed || Math.abs(x) < FROM) return 0;
    this.#pushed = true;
    return Math.sign(x);
  }
}
