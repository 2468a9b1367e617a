"""The experiments of the paper, one module each, named by the label of the figure in its LaTeX source."""
