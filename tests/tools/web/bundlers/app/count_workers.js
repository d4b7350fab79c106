// Counts the chunks that workers decode.
globalThis.decodedByWorkers = 0;
globalThis.Worker = class extends Worker {
  constructor(...given) {
    super(...given);
    this.addEventListener("message", ({ data }) => {
      if (data.decoded !== undefined) globalThis.decodedByWorkers++;
    });
  }
};
