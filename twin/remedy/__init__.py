"""Remedies: from the budget of a diagnosis to changes of machine and control, their predicted benefit, and the control's own files."""
