#: Module of the figures, for a process that draws some of them (``reports.html.drawing_process``).
FIGURES = "reports.run.figures"
