/* Operations on parts of rows, in whole vectors of any width. */
#ifndef TROCAR_ROWS_H
#define TROCAR_ROWS_H

/* Doubles in the widest vector of any processor. A row must have room for at least ROW_ROOM - 1 numbers beyond its end. */
enum { ROW_ROOM = 8 };

/* Copy or subtract the columns [begin, end) of a row: to = from, or to -= factor * from. Both work in whole steps, the first of which may begin before `begin`.
   RT */
enum { ROW_STEP = 4 };
void row_copy(const double *from, int begin, int end, double *to);
void row_subtract(double factor, const double *from, int begin, int end, double *to);

#endif
