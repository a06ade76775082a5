// What axe-core finds in the theme: bars beside blocks of code are landmarks of one name, and a wide table cannot be scrolled by keyboard.
const mend = () => {
  document.querySelectorAll(".md-code__nav:not([aria-label])").forEach((bar, index) => {
    bar.setAttribute("aria-label", `Code ${index + 1}`);
  });
  document.querySelectorAll(".md-typeset__scrollwrap:not([tabindex])").forEach((wide, index) => {
    wide.tabIndex = 0;
    wide.setAttribute("role", "region");
    wide.setAttribute("aria-label", `Table ${index + 1}`);
  });
};
new MutationObserver(mend).observe(document.body, { childList: true, subtree: true });
mend();
