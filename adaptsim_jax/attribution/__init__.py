"""Attribution: which effects does a simulator lack, judged one by one on trials that chose nothing
(docs/attribution.md).
"""
