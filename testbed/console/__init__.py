"""The operator's page: one page in a browser to watch a run and to stop it, without a GPU."""
