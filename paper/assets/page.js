// Each figure is drawn when it comes near the window.
const plots = document.querySelectorAll(".plot");
function draw(place) {
  const { figure, config } = JSON.parse(place.nextElementSibling.textContent);
  if (place.clientWidth < 500) {
    Object.assign(figure.layout.margin, { l: 48, r: 4 });
    figure.layout.font.size = 11;
  }
  Plotly.newPlot(place, figure.data, figure.layout, config);
}
const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (entry.isIntersecting) {
      seen.unobserve(entry.target);
      draw(entry.target);
    }
  }
}, { rootMargin: "600px" });
plots.forEach((place) => seen.observe(place));
