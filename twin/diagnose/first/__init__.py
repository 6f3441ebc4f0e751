"""The first answer to a recording: what each axis does, what is odd, what the recording cannot show, what to measure next.

axis_facts   lag, friction, reversals, vibration, noise of an axis, from its recorded signals alone
odd          what differs: one direction, one stroke, one axis from the others
shows        what the recording can show and what it cannot
card         the card as text and JSON, and the next measurement as a program for the control
page         the card as a page with a picture
raw          raw files to a campaign and a machine, continued from what stands in the folder
"""
