"""One reconstruction per scene of a list, on this machine or on a cluster."""
