/* Parts of rows, processed in whole vectors of any width. */
#ifndef TROCAR_ROWS_H
#define TROCAR_ROWS_H

/* Numbers in the widest vector of any processor: a row must have room for at least ROW_ROOM - 1 numbers beyond its end. */
enum { ROW_ROOM = 8 };

/* Columns [begin, end) of a row, in whole steps, of which the first may begin earlier: to = from, and to -= factor * from. RT */
enum { ROW_STEP = 4 };
void row_copy(const double *from, int begin, int end, double *to);
void row_subtract(double factor, const double *from, int begin, int end, double *to);

#endif
