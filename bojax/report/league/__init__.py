"""The page of the league of surveys: tables, figures, and a verdict for each aim."""
