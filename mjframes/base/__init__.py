"""What every stage may use: errors, files, the cache, threads, constants."""
