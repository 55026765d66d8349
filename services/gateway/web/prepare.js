// Getting the graphics card ready for something before it is drawn, so that no frame has to wait for it.

const FENCE_MS = 2000; // a card that has not come by then is drawn on all the same
const FENCE_POLL_MS = 8;

/** Compile the shaders of a group and hand its pictures over; resolves once the card has them. */
export async function prepare({ renderer, scene, camera }, group) {
  const gl = renderer.getContext();
  await passed(gl); // whatever asks the card for anything waits for all it was told before
  await renderer.compileAsync(group, camera, scene);
  group.traverse((node) => {
    for (const material of [node.material ?? []].flat()) {
      for (const value of Object.values(material)) if (value?.isTexture) renderer.initTexture(value);
    }
  });
  await passed(gl);
}

/** Until the card has done what it was told so far. Not every browser says when a shader is ready, but all of them this. */
async function passed(gl) {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  const until = performance.now() + FENCE_MS;
  const ahead = () => fence && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED;
  while (ahead() && performance.now() < until) await breath(FENCE_POLL_MS);
  gl.deleteSync(fence);
}

/** Let the page do what else is waiting. */
export const breath = (ms = 0) => new Promise((resolve) => setTimeout(resolve, ms));
