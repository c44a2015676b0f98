"""The pieces of report.html: charts, small pictures, and the page itself."""
