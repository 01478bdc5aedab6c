// Links the figures: the slot under the pointer is marked in all of them, and said in words.
// The titles say the same without this script, and give way to it.
(function () {
  const note = document.createElement('div');
  note.className = 'note';
  document.body.appendChild(note);
  const bySlot = new Map();
  document.querySelectorAll('.hit').forEach(function (hit) {
    const title = hit.querySelector('title');
    hit.words = title.textContent;
    title.remove();
    const hits = bySlot.get(hit.dataset.slot) || [];
    hits.push(hit);
    bySlot.set(hit.dataset.slot, hits);
  });
  let marked = [];
  function mark(hits) {
    marked.forEach(function (hit) { hit.classList.remove('on'); });
    hits.forEach(function (hit) { hit.classList.add('on'); });
    marked = hits;
  }
  document.addEventListener('pointermove', function (event) {
    const hit = event.target.closest ? event.target.closest('.hit') : null;
    if (!hit) {
      mark([]);
      note.style.visibility = 'hidden';
      return;
    }
    mark(bySlot.get(hit.dataset.slot));
    note.textContent = hit.words;
    const x = Math.min(event.clientX + 14, window.innerWidth - note.offsetWidth - 8);
    const below = event.clientY + 18;
    const above = event.clientY - note.offsetHeight - 12;
    const fits = window.innerHeight > below + note.offsetHeight;
    note.style.transform = 'translate(' + Math.max(x, 8) + 'px,' + (fits ? below : above) + 'px)';
    note.style.visibility = 'visible';
  });
})();
