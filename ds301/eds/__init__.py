"""Electronic data sheets: reading EDS and DCF files with repairs, and writing them."""
