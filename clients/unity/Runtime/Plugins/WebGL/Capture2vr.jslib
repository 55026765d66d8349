// Copies the files of Application.persistentDataPath, which are in memory, into the browser's IndexedDB. One copy at a time:
// what changes meanwhile is copied afterwards, once.
var Capture2vrStorage = {
  $capture2vrStorage: {
    busy: false,
    due: false,

    flush: function () {
      var storage = capture2vrStorage;
      storage.due = storage.busy;
      if (storage.busy) return;
      storage.busy = true;
      FS.syncfs(false, function (error) {
        storage.busy = false;
        if (error) console.warn('capture2vr: files are not kept for the next visit: ' + error);
        if (storage.due) storage.flush();
      });
    }
  },

  Capture2vrFlush: function () {
    capture2vrStorage.flush();
  }
};

autoAddDeps(Capture2vrStorage, '$capture2vrStorage');
mergeInto(LibraryManager.library, Capture2vrStorage);
