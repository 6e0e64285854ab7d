"""Reproduction and examination of the paper whose model and missions the package implements.

The paper is F. Yacef, N. Rizoug and L. Degaa, "Energy-Efficiency Path Planning for Quadrotor UAV
Under Wind Conditions". Its experiments are solved under every power model, and its claims are
compared with the results.
"""
