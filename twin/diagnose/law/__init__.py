"""Laws that no effect describes: measured in a block, written as formulas, and kept if they lower the cost of the closed loop.

residual     the residual of each block with the variables that it may depend on (zero_force: those of a wound-up drive train)
relations    which output may depend on which variable; measure: each as a curve, cross-validated
shapes       a curve as a formula; filters, springs and jitter: laws that are no curve over one variable
proposals    what predicts best, as settings
closed_loop  what laws and effects of an axis cost together; laws: the search for the cheapest set
wording      a law as a sentence and in the document; known_physics: what it looks like; figures: its picture
"""
