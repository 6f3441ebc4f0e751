"""Laws that no effect describes: measured on block residuals, recognised as formulas, kept where they predict in closed loop."""
