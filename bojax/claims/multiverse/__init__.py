"""Multiverse analysis: which claims of a paper hold under all choices that the paper leaves open.

Steegen et al. (2016), Increasing Transparency Through a Multiverse Analysis (Perspectives on Psychological
Science 11), and Simonsohn et al. (2020), Specification Curve Analysis (Nature Human Behaviour 4).
"""
