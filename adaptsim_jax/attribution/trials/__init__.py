"""Effects of any task of short independent trials: fits, tests and selection over functions `values -> residuals` of trials."""
