"""Reproduction and examination of the paper whose model and missions the package implements.

The paper is F. Yacef, N. Rizoug and L. Degaa, "Energy-Efficiency Path Planning for Quadrotor UAV
Under Wind Conditions". The experiments of the paper are solved under several power models, and the
claims of the paper are compared with the results.
"""
