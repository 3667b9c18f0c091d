/* The floor of latency and CPU: the gateway's system calls without its work. `floor AXES PER_BUS` prints a loopback port and ends
 * with its standard input. A datagram to the port is echoed, then each axis sends a frame to a second process, which answers it.
 */
#include <arpa/inet.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unistd.h>

enum { FRAME = 16, BUSES = 64, AT_BUSES = 2 };

static int port(struct sockaddr_in *here)
{
    socklen_t size = sizeof *here;
    int descriptor = socket(AF_INET, SOCK_DGRAM, 0);
    *here = (struct sockaddr_in){.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    if (bind(descriptor, (struct sockaddr *)here, size) || getsockname(descriptor, (struct sockaddr *)here, &size))
        exit(1);
    return descriptor;
}

/* Read one frame of each ready bus, and send it back if ``answer`` is set. */
static void take(struct pollfd *buses, int count, int answer)
{
    char frame[FRAME];
    for (int bus = 0; bus < count; bus++)
        if (buses[bus].revents && recv(buses[bus].fd, frame, FRAME, 0) == FRAME && answer)
            send(buses[bus].fd, frame, FRAME, 0);
}

int main(int count, char **arguments)
{
    if (count != 3)
        return 1;
    int axes = atoi(arguments[1]), per_bus = atoi(arguments[2]), buses = (axes + per_bus - 1) / per_bus, end[2];
    struct pollfd ready[BUSES + AT_BUSES], drives[BUSES + 1];
    struct sockaddr_in here, there, from;
    if (buses > BUSES || pipe(end))
        return 1;
    for (int bus = 0; bus < buses; bus++) {
        ready[AT_BUSES + bus] = (struct pollfd){.fd = port(&here), .events = POLLIN};
        drives[bus] = (struct pollfd){.fd = port(&there), .events = POLLIN};
        if (connect(ready[AT_BUSES + bus].fd, (struct sockaddr *)&there, sizeof there) ||
            connect(drives[bus].fd, (struct sockaddr *)&here, sizeof here))
            return 1;
    }
    drives[buses] = (struct pollfd){.fd = end[0], .events = POLLIN};
    if (!fork()) {
        close(end[1]);
        while (poll(drives, buses + 1, -1) > 0 && !drives[buses].revents)
            take(drives, buses, 1);
        return 0;
    }
    ready[0] = (struct pollfd){.fd = 0, .events = POLLIN};
    ready[1] = (struct pollfd){.fd = port(&here), .events = POLLIN};
    printf("%d\n", ntohs(here.sin_port));
    fflush(stdout);
    while (poll(ready, buses + AT_BUSES, -1) > 0 && !ready[0].revents) {
        char data[2048] = {0};
        socklen_t size = sizeof from;
        ssize_t came = ready[1].revents ? recvfrom(ready[1].fd, data, sizeof data, 0, (struct sockaddr *)&from, &size) : -1;
        if (came >= 0)
            sendto(ready[1].fd, data, came, 0, (struct sockaddr *)&from, size);
        for (int axis = 0; came >= 0 && axis < axes; axis++)
            send(ready[AT_BUSES + axis / per_bus].fd, data, FRAME, 0);
        take(ready + AT_BUSES, buses, 0);
    }
    return 0;
}
