/* Lets one thread wake another through an eventfd. */
#ifndef TROCAR_WAKE_H
#define TROCAR_WAKE_H

void wake(int eventfd);          /* RT */
void wait_for_wake(int eventfd); /* blocks until the next wake; returns at once if a wake is already pending */

#endif
