"use strict";
// Rows stay in the page; those that do not fit are hidden. Without a script the page shows all of them.
const form = document.querySelector("form"), rows = [...document.querySelectorAll("tbody tr")];
const texts = rows.map((row) => row.dataset.name.toLowerCase());
const show = () => {
  const [words, outcome, protocol] = ["words", "outcome", "protocol"].map((name) => form.elements[name].value);
  const sought = words.toLowerCase().split(/\s+/).filter(Boolean);
  let count = 0, last = null;
  rows.forEach((row, at) => {
    row.hidden = !(sought.every((word) => texts[at].includes(word))
      && (!outcome || (outcome === "broke" ? row.classList.contains("broke") : row.dataset.outcome === outcome))
      && (!protocol || row.dataset.protocols.split("|").includes(protocol)));
    if (row.hidden) return;
    count += 1;
    // The name of an adapter stands out at the first of its rows that is shown.
    row.className = `${row.dataset.id === last ? "again" : "first"}${row.classList.contains("broke") ? " broke" : ""}`;
    last = row.dataset.id;
  });
  form.elements.count.value = `${count} of ${rows.length} rows`;
};
form.hidden = false;
form.addEventListener("input", show);
form.addEventListener("submit", (event) => event.preventDefault());
show();
