/** Make a bar as long as a round number of centimetres, at most 120 pixels. */
function showScale(bar, pixelsPerCm) {
  const most = 120 / pixelsPerCm;
  const unit = 10 ** Math.floor(Math.log10(most));
  const length = unit * (most >= 5 * unit ? 5 : most >= 2 * unit ? 2 : 1);
  bar.style.width = `${length * pixelsPerCm}px`;
  bar.textContent = `${Number(length.toPrecision(1))} cm`;
}
