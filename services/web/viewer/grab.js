// What hands do to the things that they hold: one hand carries and turns, two hands also scale. Pointers are hands too.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { SCALES } from './saved-placement.js';

const APART_M = 0.02; // two hands that touch would scale by the noise of tracking

/** `onLetGo(piece)` is told when the last hand has let go. */
export function makeGrasp(onLetGo = () => {}) {
  const holds = new Map(); // piece → {hands, from: their matrices when they took hold, start: the piece's}

  function begin(piece, hands) {
    if (hands.length === 0) return holds.delete(piece);
    piece.group.updateWorldMatrix(true, false);
    const from = hands.map((hand) => hand.matrixWorld.clone());
    return holds.set(piece, { hands, from, start: piece.group.matrixWorld.clone() });
  }

  return {
    take(hand, piece) {
      this.letGo(hand);
      begin(piece, [...(holds.get(piece)?.hands || []), hand].slice(-2));
    },
    letGo(hand) {
      const piece = this.heldBy(hand);
      if (!piece) return;
      begin(piece, holds.get(piece).hands.filter((each) => each !== hand));
      if (!holds.has(piece)) onLetGo(piece);
    },
    letGoOf(piece) {
      holds.delete(piece);
    },
    heldBy: (hand) => [...holds.keys()].find((piece) => holds.get(piece).hands.includes(hand)),
    /** How many hands hold it. */
    handsOn: (piece) => holds.get(piece)?.hands.length || 0,
    /** After the hands have moved: move what they hold. */
    carry() {
      for (const [piece, { hands, from, start }] of holds) {
        if (hands.some((hand) => !hand.visible)) continue; // it is out of the headset's sight, not at its last place
        const now = hands.map((hand) => hand.matrixWorld);
        const moved = hands.length === 2 ? byTwo(from, now, start) : now[0].clone().multiply(from[0].clone().invert());
        put(piece, moved.multiply(start));
      }
    },
    /** Turn what a hand holds about the vertical, and push it away or pull it near along the hand's ray. */
    nudge(hand, { turn, push_m: push }) {
      const piece = this.heldBy(hand);
      if (!piece || this.handsOn(piece) !== 1) return;
      const middle = new THREE.Vector3().setFromMatrixPosition(piece.group.matrixWorld);
      const ahead = new THREE.Vector3(0, 0, -push).transformDirection(hand.matrixWorld).multiplyScalar(Math.abs(push));
      const about = new THREE.Matrix4().makeTranslation(middle.clone().add(ahead)).multiply(new THREE.Matrix4().makeRotationY(turn));
      put(piece, about.multiply(new THREE.Matrix4().makeTranslation(middle.negate())).multiply(piece.group.matrixWorld));
      begin(piece, [hand]);
    },
  };
}

/** (4,4) the similarity that takes the line between two hands from where it was to where it is, within the scales allowed. */
function byTwo(from, now, start) {
  const [a, b, c, d] = [...from, ...now].map((matrix) => new THREE.Vector3().setFromMatrixPosition(matrix));
  const [before, after] = [b.clone().sub(a), d.clone().sub(c)];
  const size = start.getMaxScaleOnAxis();
  const wanted = Math.max(APART_M, after.length()) / Math.max(APART_M, before.length());
  const scale = THREE.MathUtils.clamp(wanted, SCALES[0] / size, SCALES[1] / size);
  const turn = new THREE.Quaternion().setFromUnitVectors(before.normalize(), after.normalize());
  const back = new THREE.Matrix4().makeTranslation(a.add(b).multiplyScalar(-0.5));
  return new THREE.Matrix4().compose(c.add(d).multiplyScalar(0.5), turn, new THREE.Vector3().setScalar(scale)).multiply(back);
}

/** Give a piece this place in the world. */
function put(piece, world) {
  const local = piece.group.parent.matrixWorld.clone().invert().multiply(world);
  local.decompose(piece.group.position, piece.group.quaternion, piece.group.scale);
  piece.group.scale.setScalar(THREE.MathUtils.clamp(piece.group.scale.x, ...SCALES)); // no drift between the axes
  piece.group.updateMatrixWorld();
}
