// The choices above the gallery hide the cards that do not fit all of them.
document.addEventListener("DOMContentLoaded", () => {
  const choices = [...document.querySelectorAll(".gallery-filters select")];
  const cards = [...document.querySelectorAll(".gallery-card")];
  const count = document.querySelector(".gallery-count");
  if (!count) return;
  const filter = () => {
    for (const card of cards) {
      card.hidden = choices.some((c) => c.value && card.dataset[c.dataset.filter] !== c.value);
    }
    count.textContent = `${cards.filter((card) => !card.hidden).length} programs`;
  };
  for (const choice of choices) choice.addEventListener("change", filter);
  filter();
});
