"""Export of finished results to CSV files and to the loggers of other libraries."""
