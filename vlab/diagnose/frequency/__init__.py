"""Diagnosis in frequency: what a model lacks, from frequency responses and tables of modes alone.

The plant is linearised into its modes. Everything uncertain and every linear effect of the catalogue moves those modes and
what the channels see of them; which effect is missing, where, is searched on responses and modal tables in one cost.
"""
