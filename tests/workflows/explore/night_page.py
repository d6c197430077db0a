"""What tests do with the page of a night in a browser: find the lines, the yield and the devices."""

from __future__ import annotations

from dataclasses import dataclass

#: Texts of all elements of a class, shadow trees included.
TEXTS = """(name) => {
  const found = [];
  const walk = (node) => {
    if (node.classList && node.classList.contains(name)) found.push(node.innerText);
    for (const child of [...(node.shadowRoot ? node.shadowRoot.children : []), ...(node.children || [])]) walk(child);
  };
  walk(document.body);
  return found;
}"""
#: Place in the window of a line of the limit: 0 for the low end, 1 for the high one.
END = """(end) => {
  const figure = Bokeh.documents[0].get_model_by_name("Limits and distribution");
  const view = Bokeh.index.find_one(figure), box = view.canvas_view.el.getBoundingClientRect();
  const line = figure.center.filter((one) => one.type == "Span")[end], scale = view.frame.x_scale;
  const middle = view.frame.bbox.top + 0.5 * view.frame.bbox.height;
  return {x: box.x + scale.compute(line.location), y: box.y + middle, value: line.location,
          per_px: (scale.invert(101) - scale.invert(1)) / 100};
}"""
#: Place in the window of the k-th drawn device, and its name.
DEVICE = """(k) => {
  const figure = Bokeh.documents[0].get_model_by_name("Wafer map");
  const view = Bokeh.index.find_one(figure), box = view.canvas_view.el.getBoundingClientRect();
  const data = figure.renderers.find((one) => one.data_source.data.mx).data_source.data;
  return {x: box.x + view.frame.x_scale.compute(data.mx[k]), y: box.y + view.frame.y_scale.compute(data.my[k]), name: data.id[k]};
}"""


@dataclass(frozen=True)
class Dragged:
    """A line of a limit: where it is in the window [px], its value, and the change of value per pixel."""

    x: float
    y: float
    value: float
    per_px: float
