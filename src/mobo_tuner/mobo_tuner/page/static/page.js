// Says how old the page is when its server is gone: what is then on the screen cannot be refreshed.
(() => {
  let heard = Date.now();
  const note = document.createElement("div");
  note.className = "gone";
  note.setAttribute("role", "alert");
  const connected = () => window.socket?.connected ?? true;
  setInterval(() => {
    if (connected()) heard = Date.now();
    const seconds = Math.round((Date.now() - heard) / 1000);
    const gone = seconds >= 3;
    const ended = /^(Finished|Stopped|Canceled|Failed) /.test(document.title);
    document.body.classList.toggle("server-gone", gone);
    document.body.classList.toggle("run-ended", gone && ended);
    if (gone) {
      note.textContent = ended
        ? "The run had ended before the page lost its server; its report is in the run's folder."
        : `The page has lost its server: all of this is ${seconds} s old.`;
      document.body.append(note);
    } else {
      note.remove();
    }
  }, 500);
})();

// Names the boxes of the points for screen readers. A template would do, too, but the framework makes what is in one again
// with every message, whatever it is about.
(() => {
  const name = () => {
    for (const row of document.querySelectorAll(".point-table tbody tr")) {
      row.querySelector("[role=checkbox]")?.setAttribute("aria-label", `evaluation ${row.cells[1].textContent}`);
    }
  };
  const whenThere = setInterval(() => {
    const table = document.querySelector(".point-table");
    if (!table) return;
    clearInterval(whenThere);
    name();
    new MutationObserver(name).observe(table, { childList: true, subtree: true, characterData: true });
  }, 200);
})();
