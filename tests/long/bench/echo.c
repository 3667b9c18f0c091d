/* The floor of every latency figure: a UDP echo on a free loopback port. Prints the port, ends with its standard input. */
#include <arpa/inet.h>
#include <poll.h>
#include <stdio.h>
#include <sys/socket.h>

int main(void)
{
    char data[2048];
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)}, from;
    socklen_t size = sizeof here;
    int descriptor = socket(AF_INET, SOCK_DGRAM, 0);
    if (bind(descriptor, (struct sockaddr *)&here, size) || getsockname(descriptor, (struct sockaddr *)&here, &size))
        return 1;
    printf("%d\n", ntohs(here.sin_port));
    fflush(stdout);
    struct pollfd ready[] = {{.fd = descriptor, .events = POLLIN}, {.fd = 0, .events = POLLIN}};
    while (poll(ready, 2, -1) > 0 && !ready[1].revents) {
        size = sizeof from;
        ssize_t came = recvfrom(descriptor, data, sizeof data, 0, (struct sockaddr *)&from, &size);
        if (came >= 0)
            sendto(descriptor, data, came, 0, (struct sockaddr *)&from, size);
    }
    return 0;
}
