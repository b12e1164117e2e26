"""The report of a session with stimulation: one page of HTML with its pictures, for which no script is needed."""
